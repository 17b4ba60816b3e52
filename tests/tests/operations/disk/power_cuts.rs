//! Power that goes away at any moment of a server's work.
//!
//! `WAYPOST_CRASH_IMAGES` is how many disks are made and opened: see `long_runs`.

use std::collections::BTreeMap;
use std::path::Path;

use futures::StreamExt;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::runtime::Handle;
use tokio::sync::OnceCell;
use waypost_client::{Client, ClientOptions, v1};

use super::contents::contents;
use super::history::History;
use super::record::{Call, Record};
use super::scratch;
use super::script::{DRIVE, Said, work};
use super::simulated::{Image, Lie, SimulatedDisk, write_image};
use super::watched::{WatchedDisk, files_below};
use crate::harness::{Server, answers_of, as_histogram, reference_by_words, words_options};
use crate::operations::long_runs::Tries;

/// Disks that every run of the tests opens.
const IMAGES: u64 = 40;

/// Of so many disks, one is served, and the others are only read.
const SERVED: u64 = 10;

struct Recorded {
    record: Record,
    said: Said,
    history: History,
    /// Calls at which more goes on than that the log grows.
    busy: Vec<usize>,
}

impl Recorded {
    async fn new() -> Self {
        let disk = WatchedDisk::new();
        let said = work(&disk).await;
        let record = disk.record();
        let mut whole = SimulatedDisk::new(&record, &Image::new(), Lie::Nothing);
        whole.run_to(record.calls.len());
        assert!(whole.kept() == files_below(&disk.root()), "the record misses something");
        let history = History::of(&record, &Image::new()).await;
        let busy = busy(&record);
        println!(
            "{} calls, {} states of the database, {} frames acknowledged",
            record.calls.len(),
            history.states.len(),
            said.frames.len()
        );
        Self { record, said, history, busy }
    }

    /// A moment, by the number of its next call: half of them when the log does not only grow.
    fn moment(&self, random: &mut ChaCha8Rng) -> usize {
        if random.random() {
            self.busy[random.random_range(0..self.busy.len())] + random.random_range(0..2)
        } else {
            random.random_range(0..=self.record.calls.len())
        }
    }

    /// The state that must be there, or a later one, and how many frames of each session.
    fn due(&self, moment: usize) -> (usize, BTreeMap<(String, String), u64>) {
        let recorded = moment.checked_sub(1).map_or(0, |last| self.record.calls[last].end);
        let mut due = 0;
        if let Some(at_rest) = self.said.at_rest.iter().filter(|at| **at <= recorded).max() {
            due = self.history.state_at(&self.record, *at_rest);
        }
        let mut frames = BTreeMap::new();
        for frame in self.said.frames.iter().filter(|frame| frame.recorded <= recorded) {
            let count = frames.entry(frame.session.clone()).or_insert(0);
            *count = frame.count.max(*count);
        }
        for (session, count) in &frames {
            due = due.max(self.history.first_with(session, *count));
        }
        (due, frames)
    }

    /// What is wrong with what a data directory holds after a moment, if anything is.
    async fn judged(&self, data: &Path, moment: usize) -> Result<(), String> {
        let (due, _) = self.due(moment);
        let found = contents(data).await?;
        let Some(state) = self.history.state_of(&found) else {
            return Err(format!("holds what no commit left: {:?}", found.frames));
        };
        if state < due {
            return Err(format!("holds state {state}, and {due} was acknowledged"));
        }
        // A server opens it, brings it up to date, and closes it.
        let opened = waypost_server::offline::list_tokens(data.into()).await;
        opened.map(drop).map_err(|error| format!("does not open: {error}"))
    }

    /// The same by a server that serves it.
    async fn served(&self, data: &Path, moment: usize) -> Result<(), String> {
        let (_, due) = self.due(moment);
        let server = Server::try_start_on(data).await?;
        let mut client = server.client().await;
        if client.maps().await.is_err() {
            // There is a token by now.
            let options = ClientOptions::new(server.endpoint()).with_token(&self.said.secret);
            client = Client::connect(options).await.map_err(|error| error.to_string())?;
        }
        for (session, count) in &due {
            let name = format!("maps/{}/sessions/{}", session.0, session.1);
            let frames = client.frames(&name).await.map_err(|error| format!("{name}: {error}"))?;
            let said =
                self.said.frames.iter().filter(|frame| frame.session == *session && frame.count <= *count);
            for (frame, record) in said.zip(&frames) {
                if record.answer.as_ref() != Some(&frame.answer) {
                    return Err(format!("{name}: {:?} was said, and {record:?} is kept", frame.answer));
                }
            }
            if (frames.len() as u64) < *count {
                return Err(format!("{name}: {} of {count} frames are there", frames.len()));
            }
        }
        if due.contains_key(&(DRIVE.0.to_owned(), DRIVE.1.to_owned())) {
            goes_on(&client).await?;
        }
        server.stop().await;
        let findings = waypost_server::offline::check_all(data).await.map_err(|error| error.to_string())?;
        findings.into_iter().try_for_each(|finding| finding.result.map(drop))
    }
}

/// The map is what its frames come to, and takes the next one.
async fn goes_on(client: &Client) -> Result<(), String> {
    let told = |error: waypost_client::Error| error.to_string();
    for further in 0..2 {
        let map = client.map(DRIVE.0, v1::MapView::Full).await.map_err(told)?;
        let expected = &reference_by_words().maps[map.frames as usize].state_hash;
        if map.state_hash.as_ref() != Some(expected) {
            return Err(format!(
                "after {} frames the map is {:?}, not {expected}",
                map.frames, map.state_hash
            ));
        }
        if further == 0 {
            let next = as_histogram(map.frames + 1);
            let answered = answers_of(client, words_options(DRIVE.0, DRIVE.1), [next]).await;
            assert!(!answered[0].resent);
        }
    }
    Ok(())
}

/// Calls that write to the database's file, cut files, or give names.
fn busy(record: &Record) -> Vec<usize> {
    let mut databases = Vec::new();
    let mut busy = Vec::new();
    for (number, recorded) in record.calls.iter().enumerate() {
        match &recorded.call {
            Call::Opened { handle, path, .. } if path.ends_with(".sqlite") => databases.push(*handle),
            Call::Wrote { handle, .. } if databases.contains(handle) => busy.push(number),
            Call::Sized { .. }
            | Call::Renamed { .. }
            | Call::Unlinked { .. }
            | Call::MadeDirectory { .. } => {
                busy.push(number);
            }
            Call::SyncEnded { handle, .. } if databases.contains(handle) => busy.push(number),
            _ => {}
        }
    }
    busy
}

static RECORDED: OnceCell<Recorded> = OnceCell::const_new();

/// Writes an image, has it judged, and removes it, or else says where it is.
async fn judge(
    recorded: &Recorded,
    number: u64,
    (moment, lost, image): (usize, String, Image),
) -> Result<(), String> {
    let folder = scratch();
    write_image(folder.path(), &image);
    let data = folder.path().join("data");
    let mut judged = recorded.judged(&data, moment).await;
    if judged.is_ok() && number.is_multiple_of(SERVED) {
        judged = recorded.served(&data, moment).await;
    }
    judged.map_err(|error| format!("image {number}, before call {moment}, with {lost}: {error}"))
}

/// Judges images of a seed; what is wrong with them.
async fn judged(
    recorded: &'static Recorded,
    numbers: std::ops::Range<u64>,
    seed: u64,
    lie: Lie,
) -> Vec<String> {
    let mut moments: Vec<(usize, u64, ChaCha8Rng)> = numbers
        .map(|number| {
            // An image is the same whatever others are made.
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(number);
            (recorded.moment(&mut random), number, random)
        })
        .collect();
    moments.sort_by_key(|(moment, number, _)| (*moment, *number));
    let mut disk = SimulatedDisk::new(&recorded.record, &Image::new(), lie);
    let images = moments.into_iter().map(|(moment, number, mut random)| {
        disk.run_to(moment);
        let (image, lost) = disk.after_a_power_cut(&mut random);
        let runtime = Handle::current();
        tokio::task::spawn_blocking(move || runtime.block_on(judge(recorded, number, (moment, lost, image))))
    });
    let at_once = std::thread::available_parallelism().map_or(2, usize::from);
    let judged = futures::stream::iter(images).buffer_unordered(at_once);
    judged.filter_map(async |judged| judged.unwrap().err()).collect().await
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_acknowledged_is_lost_when_the_power_goes() {
    let recorded = RECORDED.get_or_init(Recorded::new).await;
    let tries = Tries::asked("CRASH_IMAGES", IMAGES);
    for part in tries.parts() {
        let wrong = judged(recorded, part.clone(), tries.seed, Lie::Nothing).await;
        tries.told(&part, format_args!("{} are wrong", wrong.len()));
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
}

/// The same disks, if they did not do what they say they did.
#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_only_says_that_it_has_stored_is_found_out() {
    let recorded = RECORDED.get_or_init(Recorded::new).await;
    for lie in [Lie::Log, Lie::Database, Lie::Folders] {
        let wrong = judged(recorded, 0..IMAGES / 2, 1, lie).await;
        println!("{lie:?}: {} of {} images are wrong", wrong.len(), IMAGES / 2);
        assert!(!wrong.is_empty(), "no image tells that {lie:?} was not stored");
    }
}
