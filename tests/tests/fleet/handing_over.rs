//! How long a robot waits for an answer while the owner of the database stops, or dies.

use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;
use waypost_client::{Client, FrameOutcome};

use super::owners::prepared;
use super::standbys::{Fleet, number};
use crate::harness::{Cluster, as_histogram, by_words_request, in_time, words_options};

/// Words at 20 Hz: what is waited for is the owner.
const BETWEEN_FRAMES: Duration = Duration::from_millis(50);
const FRAMES: u64 = 140;

/// Owners that are told to stop, and owners that are killed, each followed by another: what was acknowledged is there, and
/// how long the robot waited is said.
#[tokio::test(flavor = "multi_thread")]
async fn owners_that_go_are_followed() {
    let Some(cluster) = Cluster::running() else { return };
    let (rounds, seed) = (number("WAYPOST_TEST_HANDOVERS", 2), number("WAYPOST_TEST_HANDOVERS_SEED", 1));
    for (signal, name) in [(Signal::TERM, "drained"), (Signal::KILL, "killed")] {
        let database = prepared(&cluster, &format!("handing_over_{name}")).await;
        let fleet = Fleet::start(&database.url(), 3);
        let mut longest = Vec::new();
        for round in 0..rounds {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(round);
            longest.push(handed_over(&fleet, signal, &format!("round-{round}"), &mut random).await);
        }
        longest.sort_unstable();
        let (median, most) = (longest[longest.len() / 2], longest[longest.len() - 1]);
        eprintln!(
            "{name}, {rounds} owners of seed {seed}: a frame waited {median:.2?} (median), {most:.2?} (most)"
        );
    }
}

/// One owner goes while a robot streams through another server; the longest that the robot waited for an answer.
async fn handed_over(fleet: &Fleet, signal: Signal, map: &str, random: &mut ChaCha8Rng) -> Duration {
    let owner = fleet.owner().await;
    let reached = (owner + 1) % 3;
    let operator = fleet.client_in_time(reached).await;
    let model = operator.models().await.unwrap()[0].name.clone();
    operator.create_map(by_words_request(map, &model)).await.unwrap();
    let client = Client::connect(&fleet.endpoint(reached)).await.unwrap();
    let (mut sender, mut outcomes) = client.open_session(words_options(map, "robot")).await.unwrap().split();
    let goes = random.random_range(10..40);
    let mut longest = Duration::ZERO;
    for sequence in 1..=FRAMES {
        if sequence == goes {
            fleet.signal(owner, signal);
        }
        let sent = Instant::now();
        sender.send(as_histogram(sequence)).await.unwrap();
        match in_time(outcomes.next()).await.unwrap() {
            Some(FrameOutcome::Answer(answer)) => assert_eq!(answer.sequence, sequence),
            other => panic!("frame {sequence}: {other:?}"),
        }
        longest = longest.max(sent.elapsed());
        tokio::time::sleep(BETWEEN_FRAMES.saturating_sub(sent.elapsed())).await;
    }
    assert_eq!(client.frames(&format!("maps/{map}/sessions/robot")).await.unwrap().len() as u64, FRAMES);
    fleet.replace(owner);
    longest
}
