//! Checkpoints of maps with many places: sealed in blocks, sealed again when places were looked at, and closed with the
//! map when nobody uses it.

use std::path::Path;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::sqlite::SqliteConnection;
use sqlx::{ConnectOptions, Connection, Row};
use waypost_client::{Client, FrameContent, FrameInput, v1};

use crate::harness::{
    RawStream, ServerProcess, answers_of, by_words_request, database_options, frame, http, import_model,
    map_request, mapped, open, state_hash, word_maker, words_options,
};

/// Frame `number` of a drive past places that share few words: a frame a place.
fn view(number: u64, words: u32) -> FrameInput {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let mut seen: Vec<u32> = (0..500).map(|_| random.random_range(0..words)).collect();
    seen.sort_unstable();
    seen.dedup();
    let counts = vec![1; seen.len()];
    let histogram = v1::WordHistogram { words: seen, counts };
    FrameInput { content: FrameContent::Histogram(histogram), ..frame(1) }
}

async fn drive(client: &Client, session: &str, places: impl Iterator<Item = u64>, words: u32) {
    let frames = (1..).zip(places).map(|(sequence, place)| FrameInput {
        sequence,
        stamp_ns: sequence as i64 * 1_000_000_000,
        ..view(place, words)
    });
    let answers = answers_of(client, words_options("drive", session), frames).await;
    assert!(!answers.is_empty());
}

async fn numbers(directory: &Path, query: &'static str) -> Vec<i64> {
    let options = database_options(directory);
    let mut database: SqliteConnection = options.connect().await.unwrap();
    let row = sqlx::query(query).fetch_one(&mut database).await.unwrap();
    let numbers = (0..row.len()).map(|column| row.get(column)).collect();
    database.close().await.unwrap();
    numbers
}

async fn open_maps(server: &ServerProcess) -> f64 {
    let url = format!("http://{}/metrics", server.http());
    let metrics = http().get(url).send().await.unwrap().text().await.unwrap();
    let line = metrics.lines().find_map(|line| line.strip_prefix("waypost_open_maps ")).unwrap();
    line.parse().unwrap()
}

async fn open_maps_become(server: &ServerProcess, expected: f64) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while open_maps(server).await != expected {
        assert!(Instant::now() < deadline, "{} maps stay open", open_maps(server).await);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn places_are_sealed_in_blocks_and_again_when_they_have_changed() {
    const PLACES: u64 = 2_400;
    const SEEN_AGAIN: u64 = 400;
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("drive", &model.name)).await.unwrap();
    drive(&client, "first", 0..PLACES, model.words).await;
    let places = client.map("drive", v1::MapView::Full).await.unwrap().places;
    assert!(places > PLACES - PLACES / 10, "{places} places");
    // Killed while the last checkpoints are being written, perhaps: the log has what they lack.
    let hash = state_hash(&client, "drive").await;
    server.kill();
    let [blocks, sealed, most_bytes] = numbers(
        directory.path(),
        "SELECT count(*), sum(places), max(length(content)) FROM checkpoint_blocks",
    )
    .await[..] else {
        unreachable!("three columns")
    };
    assert!(blocks >= 1 && (1_000..places as i64).contains(&sealed), "{blocks} blocks of {sealed} places");
    assert!(most_bytes <= 1 << 20, "{most_bytes} bytes");

    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    assert_eq!(state_hash(&client, "drive").await, hash, "from blocks and the log");
    let first_sealed =
        numbers(directory.path(), "SELECT events FROM checkpoint_blocks WHERE first_place = 0").await;
    drive(&client, "second", 0..SEEN_AGAIN, model.words).await;
    let grown = client.map("drive", v1::MapView::Full).await.unwrap();
    assert!(grown.places < places + SEEN_AGAIN / 10, "{} places of {places}", grown.places);
    server.stop();
    let again = numbers(directory.path(), "SELECT events FROM checkpoint_blocks WHERE first_place = 0").await;
    assert!(again > first_sealed, "sealed at {first_sealed:?} and {again:?}");
    let [events, rows] = numbers(
        directory.path(),
        "SELECT (SELECT events FROM checkpoints), (SELECT count(*) FROM checkpoint_places)",
    )
    .await[..] else {
        unreachable!("two columns")
    };
    assert_eq!(events as u64, grown.frames + grown.sessions);
    assert!((rows as u64) < grown.places, "{rows} rows of single places");

    let server = ServerProcess::start(directory.path());
    assert_eq!(
        Some(state_hash(&server.client().await, "drive").await),
        grown.state_hash,
        "from the checkpoint"
    );
    server.stop();
    numbers(directory.path(), "DELETE FROM checkpoints RETURNING events").await;
    let server = ServerProcess::start(directory.path());
    assert_eq!(Some(state_hash(&server.client().await, "drive").await), grown.state_hash, "by full replay");
    server.stop();
}

/// Without any memory for maps, each is closed when nobody asks for it any more, and is there when somebody does.
#[tokio::test(flavor = "multi_thread")]
async fn maps_that_nobody_uses_are_closed_and_come_back() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start_with(directory.path(), &["--map-memory-mib", "0"]);
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("drive", &model.name)).await.unwrap();
    client.create_map(map_request("looked-at", &model.name)).await.unwrap();
    mapped(&client, "robot", 1..=20).await;
    let hash = state_hash(&client, "drive").await;
    // A robot that only looks is kept for as long as its stream is open.
    let watcher = v1::OpenSession {
        mode: v1::SessionMode::Localize.into(),
        words_hash: word_maker().words_hash().to_owned(),
        ..open("looked-at", "watcher")
    };
    let (watching, _) = RawStream::open(&server.endpoint(), watcher).await.unwrap();
    open_maps_become(&server, 1.0).await;
    assert_eq!(state_hash(&client, "drive").await, hash);
    assert_eq!(open_maps(&server).await, 2.0);
    let went_on = mapped(&client, "robot", 21..=25).await;
    assert_eq!(went_on.len(), 5);
    drop(watching);
    open_maps_become(&server, 0.0).await;
    assert_ne!(state_hash(&client, "drive").await, hash);
    server.stop();
}
