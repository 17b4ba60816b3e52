//! Calls of the disk that fail while a server serves, starts and stops: frames are refused or taken, never lost, and the
//! server goes on when the disk is well.
//!
//! `WAYPOST_DISK_FAULTS` is how many calls fail, from the seed `WAYPOST_DISK_FAULTS_SEED`.

use std::collections::BTreeMap;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_client::{Code, v1};
use waypost_proto::v1::stream_response::Content as Response;

use super::number;
use super::script::kept;
use super::watched::{Calls, Fault, How, WatchedDisk, copy_below};
use crate::harness::{
    RawStream, Server, as_histogram, by_words_request, frame_count, import_model, in_time, open,
    reference_by_words, state_hash, wire, word_maker,
};

/// Calls that fail in every run of the tests.
const FAULTS: u64 = 80;

/// While one server serves; then it is stopped or killed, and what it left is looked at.
const FAULTS_OF_A_SERVER: u64 = 16;

/// Frames that are to be taken in spite of each fault.
const FRAMES_OF_A_FAULT: u64 = 2;

const EIO: i32 = 5;
const ENOSPC: i32 = 28;

/// A directory with the map `drive`, which has no frame.
async fn one_map() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("drive", &model.name)).await.unwrap();
    server.stop().await;
    directory
}

fn a_fault(random: &mut ChaCha8Rng) -> Fault {
    // Two frames make so many calls, or few more.
    let calls = [(Calls::CHANGES, 40), (Calls("w"), 40), (Calls("s"), 2), (Calls("r"), 6), (Calls::ALL, 40)];
    let (calls, most) = calls[random.random_range(0..calls.len())];
    let nth = random.random_range(1..=most);
    let how = [How::Once, How::FromThenOn, How::Short][random.random_range(0..3)];
    Fault { nth, calls, how, error: [EIO, ENOSPC][random.random_range(0..2)] }
}

/// A robot's session, and what it was answered.
struct Robot {
    endpoint: String,
    stream: Option<RawStream>,
    answered: BTreeMap<u64, v1::FrameAnswer>,
    refusals: u64,
}

impl Robot {
    /// Sends a frame until it is taken. The disk is mended after some refusals.
    async fn sends(&mut self, disk: &WatchedDisk, sequence: u64, case: &str) {
        const MENDED_AFTER: u32 = 3;
        for attempt in 0..40 {
            if attempt == MENDED_AFTER {
                disk.mend();
            }
            match self.attempt(sequence).await {
                Ok(answer) => {
                    self.answered.insert(sequence, kept(&answer));
                    return;
                }
                Err((code, message)) => {
                    self.refusals += 1;
                    assert_eq!(code, Code::Unavailable, "{case}: {message}");
                }
            }
        }
        panic!("{case}: frame {sequence} is not taken though the disk is well");
    }

    async fn attempt(&mut self, sequence: u64) -> Result<v1::FrameAnswer, (Code, String)> {
        let refused = |status: tonic::Status| (status.code(), status.message().to_owned());
        if self.stream.is_none() {
            let words_hash = word_maker().words_hash().to_owned();
            let opening = v1::OpenSession { words_hash, ..open("drive", "robot") };
            let (stream, opened) = RawStream::open(&self.endpoint, opening).await.map_err(refused)?;
            let last = self.answered.last_key_value().map(|(sequence, _)| *sequence);
            assert!(opened.last_committed_sequence >= last, "{last:?} was acknowledged: {opened:?}");
            self.stream = Some(stream);
        }
        let frame = wire(as_histogram(sequence));
        match self.stream.as_mut().unwrap().frame(frame).await {
            Ok(Response::Answer(answer)) => Ok(answer),
            Ok(Response::Refusal(refusal)) => {
                let status = refusal.status.unwrap();
                Err((Code::from(status.code), status.message))
            }
            Ok(other) => panic!("{other:?}"),
            Err(status) => {
                self.stream = None;
                Err(refused(status))
            }
        }
    }
}

/// What is in the directory is what was answered.
async fn holds(data: &Path, answered: &BTreeMap<u64, v1::FrameAnswer>, case: &str) {
    let server = Server::start_on(data).await;
    let client = server.client().await;
    let records = client.frames("maps/drive/sessions/robot").await.unwrap();
    let there: BTreeMap<u64, v1::FrameAnswer> = records
        .iter()
        .map(|record| record.answer.clone().unwrap())
        .map(|answer| (answer.sequence, answer))
        .collect();
    assert_eq!(there.len(), records.len(), "{case}: a frame is there twice");
    for (sequence, answer) in answered {
        assert_eq!(there.get(sequence), Some(answer), "{case}: frame {sequence}");
    }
    let expected = &reference_by_words().maps[records.len()].state_hash;
    assert_eq!(state_hash(&client, "drive").await, *expected, "{case}");
    server.stop().await;
    for finding in waypost_server::offline::check_all(data).await.unwrap() {
        assert!(finding.result.is_ok(), "{case}: {finding:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_that_fail_lose_nothing_and_the_server_goes_on() {
    let template = one_map().await;
    let (faults, seed) = (number("WAYPOST_DISK_FAULTS", FAULTS), number("WAYPOST_DISK_FAULTS_SEED", 1));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut fired, mut refusals) = (0, 0);
    for first in (0..faults).step_by(FAULTS_OF_A_SERVER as usize) {
        let disk = WatchedDisk::new();
        copy_below(template.path(), &disk.data());
        let mut server = disk.start();
        let endpoint = server.endpoint();
        let mut robot = Robot { endpoint, stream: None, answered: BTreeMap::new(), refusals: 0 };
        let mut sequence = 0;
        for number in first..faults.min(first + FAULTS_OF_A_SERVER) {
            let fault = a_fault(&mut random);
            let case = format!("fault {number} of seed {seed}, {fault:?}");
            disk.arm(fault);
            // A session that is opened anew reads and writes, too.
            if random.random_range(0..4) == 0 {
                robot.stream = None;
            }
            for _ in 0..FRAMES_OF_A_FAULT {
                sequence += 1;
                robot.sends(&disk, sequence, &case).await;
            }
            fired += u64::from(disk.counted().1 > 0);
            disk.mend();
            assert!(server.is_running(), "{case}: the server ended:\n{}", server.log());
        }
        assert!(!server.log().contains("panicked"), "{}", server.log());
        refusals += robot.refusals;
        if random.random() {
            server.stop();
        } else {
            server.kill();
        }
        holds(
            &disk.data(),
            &robot.answered,
            &format!("after fault {first} of seed {seed} and those that follow"),
        )
        .await;
    }
    println!("{faults} faults of seed {seed}, {fired} of them met a call, {refusals} refusals");
    assert!(fired * 8 > faults && refusals > 0, "{fired} faults met a call");
    assert!(FAULTS_OF_A_SERVER * FRAMES_OF_A_FAULT < frame_count());
}

/// Calls that fail while a server starts, or while it stops, in every run of the tests.
const STARTS: u64 = 12;

#[tokio::test(flavor = "multi_thread")]
async fn calls_that_fail_at_a_start_or_a_stop_lose_nothing() {
    const FRAMES: u64 = 6;
    let template = one_map().await;
    let (faults, seed) = (number("WAYPOST_DISK_START_FAULTS", STARTS), number("WAYPOST_DISK_FAULTS_SEED", 1));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // A log that was not folded in, as after a kill.
    let disk = WatchedDisk::new();
    copy_below(template.path(), &disk.data());
    let server = disk.start();
    let mut robot =
        Robot { endpoint: server.endpoint(), stream: None, answered: BTreeMap::new(), refusals: 0 };
    for sequence in 1..=FRAMES {
        robot.sends(&disk, sequence, "no fault").await;
    }
    server.kill();
    let answered = robot.answered;
    let left = disk;
    let (mut refused, mut started) = (0, 0);
    for number in 0..faults {
        let disk = WatchedDisk::new();
        copy_below(&left.data(), &disk.data());
        let fault = Fault { nth: random.random_range(1..=60), ..a_fault(&mut random) };
        let case = format!("start {number} of seed {seed}, {fault:?}");
        let at_stop = number.is_multiple_of(2);
        if !at_stop {
            disk.arm(fault);
        }
        match disk.try_start() {
            Ok(mut server) => {
                started += 1;
                disk.arm(fault);
                let ended = in_time(async { server.terminate(std::time::Duration::from_secs(20)) }).await;
                assert!(ended.is_some(), "{case}: it does not stop:\n{}", server.log());
                assert!(!server.log().contains("panicked"), "{case}: {}", server.log());
            }
            Err(said) => {
                refused += 1;
                assert!(!at_stop, "{case}: {said}");
                assert!(said.contains("waypost-server: ") && !said.contains("panicked"), "{case}: {said}");
            }
        }
        disk.mend();
        holds(&disk.data(), &answered, &case).await;
    }
    println!("{faults} faults of seed {seed}: {started} starts, {refused} were refused with a reason");
    assert!(refused > 0 && started > 0);
}
