//! Calls of the disk that fail while a server serves, starts and stops: frames are refused or taken, never lost, and the
//! server goes on when the disk is well.
//!
//! `WAYPOST_DISK_FAULTS` is how many calls fail, and `WAYPOST_DISK_START_FAULTS` how many while a server starts or stops: see
//! `long_runs`.

use std::collections::BTreeMap;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_client::{Code, Error, v1};
use waypost_proto::v1::stream_response::Content as Response;

use super::script::kept;
use super::watched::{Calls, Fault, How, WatchedDisk, copy_below};
use crate::harness::{
    RawStream, Server, as_histogram, by_words_request, frame_count, import_model, in_time, open,
    reference_by_words, state_hash, wire, word_maker,
};
use crate::operations::long_runs::Tries;

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
    fn of(endpoint: String) -> Self {
        Self { endpoint, stream: None, answered: BTreeMap::new(), refusals: 0 }
    }

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
    let tries = Tries::asked("DISK_FAULTS", FAULTS);
    let seed = tries.seed;
    let (mut fired, mut refusals) = (0, 0);
    let of_servers = tries.parts().flat_map(|part| {
        (part.start..part.end)
            .step_by(FAULTS_OF_A_SERVER as usize)
            .map(move |first| first..part.end.min(first + FAULTS_OF_A_SERVER))
    });
    for part in of_servers {
        let first = part.start;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(first);
        let disk = WatchedDisk::new();
        copy_below(template.path(), &disk.data());
        let mut server = disk.start();
        let mut robot = Robot::of(server.endpoint());
        let mut sequence = 0;
        for number in part.clone() {
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
        tries.told(&part, format_args!("{fired} met a call so far, with {refusals} refusals"));
    }
    assert!(fired * 4 > tries.count() && refusals > 0, "{fired} faults met a call");
    assert!(FAULTS_OF_A_SERVER * FRAMES_OF_A_FAULT < frame_count());
}

/// Frames that were taken before the server was killed: its write-ahead log was not folded in.
const LEFT_FRAMES: u64 = 6;

/// What a server that was killed has left, and what it had answered.
async fn left_by_a_kill() -> (WatchedDisk, BTreeMap<u64, v1::FrameAnswer>) {
    let template = one_map().await;
    let disk = WatchedDisk::new();
    copy_below(template.path(), &disk.data());
    let server = disk.start();
    let mut robot = Robot::of(server.endpoint());
    for sequence in 1..=LEFT_FRAMES {
        robot.sends(&disk, sequence, "no fault").await;
    }
    server.kill();
    (disk, robot.answered)
}

/// A read that fails is told as such, and is no damage: the next one is well, and the map takes frames, also after a restart.
#[tokio::test(flavor = "multi_thread")]
async fn a_read_that_fails_once_is_no_damage() {
    const READS: u32 = 6;
    let (left, answered) = left_by_a_kill().await;
    let mut refused = 0;
    for nth in 1..=READS {
        let case = format!("read {nth}");
        let disk = WatchedDisk::new();
        copy_below(&left.data(), &disk.data());
        let server = disk.start();
        let client = server.client().await;
        disk.arm(Fault { nth, calls: Calls("r"), how: How::Once, error: EIO });
        let session = "maps/drive/sessions/robot";
        if let Err(error) = client.frames(session).await {
            assert!(matches!(&error, Error::Status { code: Code::Unavailable, .. }), "{case}: {error}");
            refused += 1;
        }
        disk.mend();
        let records = client.frames(session).await.unwrap_or_else(|error| panic!("{case}: {error}"));
        assert_eq!(records.len() as u64, LEFT_FRAMES, "{case}");
        let mut robot = Robot { answered: answered.clone(), ..Robot::of(server.endpoint()) };
        robot.sends(&disk, LEFT_FRAMES + 1, &case).await;
        assert_eq!(robot.refusals, 0, "{case}");
        server.kill();
        holds(&disk.data(), &robot.answered, &case).await;
    }
    assert!(refused > 0, "no read of these was met");
}

/// Calls that fail while a server starts, or while it stops, in every run of the tests.
const STARTS: u64 = 12;

#[tokio::test(flavor = "multi_thread")]
async fn calls_that_fail_at_a_start_or_a_stop_lose_nothing() {
    let tries = Tries::asked("DISK_START_FAULTS", STARTS);
    let seed = tries.seed;
    let (left, answered) = left_by_a_kill().await;
    let (mut refused, mut started) = (0, 0);
    for number in tries.parts().flatten() {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(number);
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
    println!(
        "{} faults of seed {seed}: {started} starts, {refused} were refused with a reason",
        tries.count()
    );
    assert!(refused > 0 && started > 0);
}
