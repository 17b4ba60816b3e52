//! `kill -9` in the middle of a stream: what was acknowledged stays, nothing is there twice, and the
//! map becomes what it would have become.

use std::collections::BTreeMap;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_client::{Client, FrameOutcome, v1};

use crate::harness::{
    Proxy, ServerProcess, answers, frame, frame_count, import_model, in_time, map_request, reference,
    session_options, stream_through,
};

const KILLS: u64 = 20;

#[tokio::test(flavor = "multi_thread")]
async fn twenty_kills_lose_nothing_and_change_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(20);
    let mut acknowledged: BTreeMap<u64, v1::FrameAnswer> = BTreeMap::new();
    prepare(directory.path()).await;

    for kill in 0..KILLS {
        let left = frame_count() - acknowledged.len() as u64;
        let until_kill = random.random_range(0..=2 * left / (KILLS - kill + 1));
        // Between an answer and the next: while a frame is decoded, decided or committed.
        let pause = Duration::from_millis(random.random_range(0..120));
        let server = ServerProcess::start(directory.path());
        drive_until_killed(server, &mut acknowledged, until_kill, pause).await;
    }
    assert!(
        !acknowledged.is_empty() && (acknowledged.len() as u64) < frame_count(),
        "{}",
        acknowledged.len()
    );

    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let from_the_start = answers(&client, "drive", "robot", (1..=frame_count()).map(frame)).await;
    for answer in &from_the_start {
        if let Some(before) = acknowledged.get(&answer.sequence) {
            assert!(answer.resent, "frame {} was lost", answer.sequence);
            assert_eq!(decided(answer), decided(before));
        }
    }
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    let expected = &reference().maps[frame_count() as usize];
    assert_eq!(map.frames, frame_count());
    assert_eq!((map.places, map.links), (expected.places, expected.links));
    assert_eq!(map.state_hash, Some(expected.state_hash.clone()));
    let sequences: Vec<u64> = from_the_start.iter().map(|answer| answer.sequence).collect();
    assert_eq!(sequences, (1..=frame_count()).collect::<Vec<_>>());
    assert_eq!(client.loop_closures("drive").await.unwrap().len() as u64, map.loop_closures);
    server.stop();
}

/// A robot that keeps one session of the client library through kills does not notice them.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_of_the_client_outlives_kills() {
    const FRAMES: u64 = 40;
    const KILLED_AFTER: [u64; 3] = [0, 11, 27];
    let directory = tempfile::tempdir().unwrap();
    prepare(directory.path()).await;
    let proxy = Proxy::start().await;
    let server = ServerProcess::start(directory.path());
    proxy.forward_to(Some(server.grpc()));

    let client = Client::connect(&proxy.endpoint()).await.unwrap();
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let server = stream_through(session, FRAMES, frame, server, |answered, server| {
        if !KILLED_AFTER.contains(&answered) {
            return server;
        }
        proxy.forward_to(None);
        server.kill();
        let server = ServerProcess::start(directory.path());
        proxy.forward_to(Some(server.grpc()));
        server
    })
    .await;
    let map = server.client().await.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, FRAMES);
    assert_eq!(map.state_hash, Some(reference().maps[FRAMES as usize].state_hash.clone()));
}

async fn prepare(directory: &std::path::Path) {
    let server = ServerProcess::start(directory);
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    // Not stopped in good order either.
    server.kill();
}

/// Streams what is not acknowledged yet; kills the server after `until_kill` answers and a pause.
async fn drive_until_killed(
    server: ServerProcess,
    acknowledged: &mut BTreeMap<u64, v1::FrameAnswer>,
    until_kill: u64,
    pause: Duration,
) {
    let client = server.client().await;
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let last = acknowledged.last_key_value().map(|(&sequence, _)| sequence);
    let durable = session.opened().last_committed_sequence;
    assert!(durable >= last, "{last:?} was acknowledged, but only {durable:?} is durable");

    let next = last.unwrap_or(0) + 1;
    let (mut sender, mut outcomes) = session.split();
    let sending = tokio::spawn(async move {
        for sequence in next..=frame_count() {
            if sender.send(frame(sequence)).await.is_err() {
                return;
            }
        }
    });
    for expected in next..next + until_kill {
        let answer = match in_time(outcomes.next()).await.unwrap() {
            Some(FrameOutcome::Answer(answer)) => answer,
            other => panic!("frame {expected}: {other:?}"),
        };
        assert_eq!(answer.sequence, expected);
        // Frames that were committed before the last kill, while their answer was lost.
        assert_eq!(answer.resent, durable.is_some_and(|durable| expected <= durable), "frame {expected}");
        acknowledged.insert(expected, answer);
    }
    tokio::time::sleep(pause).await;
    server.kill();
    drop(outcomes);
    sending.await.unwrap();
}

/// An answer but for what is of the moment.
fn decided(answer: &v1::FrameAnswer) -> v1::FrameAnswer {
    v1::FrameAnswer { last_committed_sequence: 0, timings: None, resent: false, ..answer.clone() }
}
