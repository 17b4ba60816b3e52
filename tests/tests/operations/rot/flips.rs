//! Bits that flip, one at a time, anywhere: each is found or harmless, and nothing is served changed in silence.
//!
//! `WAYPOST_FLIPS` is how many are tried: see `long_runs`.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;
use std::sync::Arc;

use futures::StreamExt;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};
use sqlx::{ConnectOptions, Connection};
use waypost_client::{Client, Code, Error, v1};

use super::{note as frame_note, two_maps};
use crate::harness::{Server, database_options, in_time};
use crate::operations::disk::{on_a_thread, scratch};
use crate::operations::long_runs::Tries;

/// Those that every run of the tests tries.
const FLIPS: u64 = 60;

/// Bytes of a page of the file.
const PAGE_BYTES: usize = 4096;

/// What was served: each answer as text, or the error that was told.
type Served = BTreeMap<String, Result<String, Code>>;

fn note<T: Debug>(served: &mut Served, what: &str, answer: Result<T, Error>) {
    let answer = match answer {
        Ok(answer) => Ok(format!("{answer:?}")),
        Err(Error::Status { code, .. }) => Err(code),
        Err(other) => panic!("{what}: {other}"),
    };
    served.insert(what.to_owned(), answer);
}

/// The same for bytes, of which a hash tells whether they are others.
fn note_bytes(served: &mut Served, what: &str, answer: Result<impl AsRef<[u8]>, Error>) {
    note(served, what, answer.map(|bytes| Sha256::digest(bytes)));
}

/// The frames that whoever watches a map from its beginning is told.
async fn watched(client: &Client, map: &str, frames: usize) -> Result<Vec<v1::MapEvent>, Error> {
    let mut watch = client.watch_map(map, Some(0)).await?;
    let mut told = Vec::new();
    while told.len() < frames {
        told.push(in_time(watch.next()).await?);
    }
    Ok(told)
}

/// Asks for all that the maps hold.
async fn all_of(client: &Client) -> Served {
    let mut served = Served::new();
    let maps = client.maps().await.map(|maps| maps.into_iter().map(|map| map.name).collect::<Vec<_>>());
    note(&mut served, "maps", maps);
    note(&mut served, "models", client.models().await);
    note(&mut served, "tokens", client.tokens().await);
    let called = client.frames_called("maps/drive/sessions/first", &frame_note(9)).await;
    note(&mut served, "the frame of a note", called);
    for (map, sessions, frames) in [("drive", &["first", "second"][..], 32), ("spare", &["only"], 5)] {
        note(&mut served, &format!("{map}: events"), watched(client, map, frames).await);
        // What checkpoints weigh is not what a map is.
        let whole = client.map(map, v1::MapView::Full).await.map(|whole| v1::Map { storage: None, ..whole });
        note(&mut served, map, whole);
        note(&mut served, &format!("{map}: places"), client.places(map).await);
        note(&mut served, &format!("{map}: closures"), client.loop_closures(map).await);
        note(&mut served, &format!("{map}: labels"), client.labels(map).await);
        note(&mut served, &format!("{map}: sessions"), client.sessions(map).await);
        let mut snapshot = Vec::new();
        let exported = in_time(client.export_map(map, &mut snapshot)).await;
        note_bytes(&mut served, &format!("{map}: export"), exported.map(|_| snapshot));
        for session in sessions {
            let name = format!("maps/{map}/sessions/{session}");
            note(&mut served, &format!("{name}: frames"), client.frames(&name).await);
            let pictured = client.frame_picture(&format!("{name}/frames/20"), None).await;
            note_bytes(&mut served, &format!("{name}: picture"), pictured);
        }
    }
    served
}

/// What came of a flip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Flip {
    Harmless,
    /// The server did not start, or some answer was an error that says so.
    Found,
    /// Something was served that is not what was stored.
    Silent,
}

async fn what_comes_of(directory: &Path, whole: &Served) -> (Flip, String) {
    let server = match Server::try_start_on(directory).await {
        Ok(server) => server,
        Err(error) => return (Flip::Found, error),
    };
    let served = all_of(&server.client().await).await;
    server.stop().await;
    let mut flip = (Flip::Harmless, String::new());
    for (what, answer) in &served {
        let came = match (answer, &whole[what]) {
            (now, before) if now == before => Flip::Harmless,
            // What is there must not be told to be missing.
            (Err(Code::NotFound), _) | (Ok(_), _) => Flip::Silent,
            (Err(_), _) => Flip::Found,
        };
        flip = flip.max((came, what.clone()));
    }
    flip
}

fn copied(from: &Path) -> tempfile::TempDir {
    let directory = scratch();
    std::fs::copy(from.join("waypost.sqlite"), directory.path().join("waypost.sqlite")).unwrap();
    directory
}

async fn served_by(directory: &Path) -> Served {
    let copy = copied(directory);
    let server = Server::start_on(copy.path()).await;
    let served = all_of(&server.client().await).await;
    server.stop().await;
    served
}

/// Flips one bit of what the log has of an event, past SQLite's own and the file's checksums.
async fn flip_in_the_log(directory: &Path, random: &mut ChaCha8Rng) -> String {
    let mut database = database_options(directory).connect().await.unwrap();
    let rows: Vec<(i64, Vec<u8>)> =
        sqlx::query_as("SELECT rowid, event FROM log ORDER BY rowid").fetch_all(&mut database).await.unwrap();
    let (row, mut event) = rows[random.random_range(0..rows.len())].clone();
    let bit = random.random_range(0..event.len() * 8);
    event[bit / 8] ^= 1 << (bit % 8);
    sqlx::query("UPDATE log SET event = ? WHERE rowid = ?")
        .bind(event)
        .bind(row)
        .execute(&mut database)
        .await
        .unwrap();
    database.close().await.unwrap();
    format!("bit {bit} of the log's row {row}")
}

#[tokio::test(flavor = "multi_thread")]
async fn no_flip_is_served_in_silence() {
    let directory = Arc::new(two_maps().await);
    let whole = Arc::new(served_by(directory.path()).await);
    let tries = Tries::asked("FLIPS", FLIPS);
    // Much of a try is waiting, as for a server that ends.
    let at_once = 3 * std::thread::available_parallelism().map_or(2, usize::from);
    let mut counts = BTreeMap::new();
    for part in tries.parts() {
        let flips = part.clone().map(|flip| {
            let directory = directory.clone();
            let whole = whole.clone();
            on_a_thread(
                move || async move { (flip, flipped(directory.path(), &whole, tries.seed, flip).await) },
            )
        });
        let mut flips = futures::stream::iter(flips).buffer_unordered(at_once);
        while let Some(flip) = flips.next().await {
            let (flip, (came, what)) = flip.unwrap();
            assert_ne!(came, Flip::Silent, "{what} is another, flip {flip} of seed {}", tries.seed);
            *counts.entry(came).or_insert(0) += 1;
        }
        tries.told(&part, format_args!("{counts:?} so far"));
    }
    assert!(counts[&Flip::Found] > 0);
}

/// What comes of one flip, and where it is.
async fn flipped(directory: &Path, whole: &Served, seed: u64, flip: u64) -> (Flip, String) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(flip);
    let copy = copied(directory);
    let file = copy.path().join("waypost.sqlite");
    let place = if flip.is_multiple_of(3) {
        flip_in_the_log(copy.path(), &mut random).await
    } else {
        let mut bytes = std::fs::read(&file).unwrap();
        let bit = random.random_range(0..bytes.len() * 8);
        bytes[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&file, bytes).unwrap();
        format!("bit {} of page {}", bit % (PAGE_BYTES * 8), bit / (PAGE_BYTES * 8) + 1)
    };
    let (came, what) = what_comes_of(copy.path(), whole).await;
    (came, format!("{place}: {what}"))
}

/// The same flips in the log with checksums made for what they left, as if there were none.
#[tokio::test(flavor = "multi_thread")]
async fn without_checksums_flips_are_served_in_silence() {
    let directory = two_maps().await;
    let whole = served_by(directory.path()).await;
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut silent = 0;
    for _ in 0..25 {
        let copy = copied(directory.path());
        flip_in_the_log(copy.path(), &mut random).await;
        // As a server does with events that have none.
        super::sql(copy.path(), "INSERT INTO upkeep (task) VALUES ('log_checksums')").await;
        let (came, _) = what_comes_of(copy.path(), &whole).await;
        silent += u32::from(came == Flip::Silent);
    }
    assert!(silent > 0, "this would not show what checksums are for");
}
