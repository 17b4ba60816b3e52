//! A full disk: frames are refused with the reason, nothing is lost, and space heals it.

use std::path::Path;
use std::process::Output;
use std::time::Duration;

use waypost_client::{Client, Code, FrameOutcome, v1};

use waypost_proto::v1::stream_response::Content as Response;

use crate::harness::{
    Built, RawStream, ServerProcess, SmallDisk, assert_status, first_return, frame, import_model, in_time,
    map_request, open, path, reference, refused, run_to_its_end, session_options, state_hash, stream, wire,
};

/// Of a disk for a server and its map.
const DISK_MIB: u32 = 24;

async fn serving(data_dir: &Path) -> (ServerProcess, Client) {
    let server = ServerProcess::start(data_dir);
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    (server, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_refuses_frames_and_loses_none() {
    const BEFORE: u64 = 6;
    let Some(disk) = SmallDisk::mount(DISK_MIB) else { return };
    let (mut server, client) = serving(&disk.folder()).await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    for sequence in 1..=BEFORE {
        raw.answered(wire(frame(sequence))).await;
    }
    let before = client.map("drive", v1::MapView::Full).await.unwrap();

    disk.fill();
    for attempt in 1..=3 {
        let refusal = raw.refused(wire(frame(BEFORE + 1))).await;
        let status = refusal.status.unwrap();
        let case = format!("attempt {attempt}");
        assert_status(&case, (Code::from(status.code), &status.message), Code::Unavailable, "disk is full");
        assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap(), before);
    }
    let stored = raw.answered(wire(frame(BEFORE))).await;
    assert!(stored.resent);
    let other = RawStream::open(&server.endpoint(), open("drive", "another")).await.map(drop);
    let status = other.unwrap_err();
    assert_status("session", (status.code(), status.message()), Code::Unavailable, "disk is full");
    assert!(client.create_map(map_request("new", "shipped")).await.is_err());
    assert!(server.is_running());

    disk.free();
    let answer = raw.answered(wire(frame(BEFORE + 1))).await;
    assert!(!answer.resent);
    assert_eq!(state_hash(&client, "drive").await, reference().maps[BEFORE as usize + 1].state_hash);
    server.stop();
}

/// An acknowledgement means the same on a full disk as on any other.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_acknowledged_on_a_full_disk_survives_a_kill() {
    const BEFORE: u64 = 6;
    let Some(disk) = SmallDisk::mount(DISK_MIB) else { return };
    let (server, client) = serving(&disk.folder()).await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    for sequence in 1..=BEFORE {
        raw.answered(wire(frame(sequence))).await;
    }
    disk.fill();
    let mut acknowledged = BEFORE;
    for _ in 0..12 {
        // What was refused is sent again, as the refusal says.
        if let Response::Answer(answer) = raw.frame(wire(frame(acknowledged + 1))).await.unwrap() {
            acknowledged = answer.sequence;
        }
        client.map("drive", v1::MapView::Full).await.unwrap();
    }
    server.kill();
    disk.free();
    let server = ServerProcess::start(&disk.folder());
    let (_, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, Some(acknowledged), "acknowledged frames are gone");
    server.stop();
}

/// A robot that keeps streaming through it all notices nothing but the delay.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_of_the_client_outlives_a_full_disk() {
    const ROUNDS: u32 = 6;
    let Some(disk) = SmallDisk::mount(DISK_MIB) else { return };
    let (server, client) = serving(&disk.folder()).await;
    let frames = first_return() + 20;
    let mut options = session_options("drive", "robot");
    options.reconnection.longest_delay = Duration::from_millis(400);
    options.reconnection.give_up_after = Duration::from_secs(20);
    let session = client.open_session(options).await.unwrap();
    let streaming = tokio::spawn(stream(session, (1..=frames).map(frame)));
    for round in 0..ROUNDS {
        disk.fill();
        tokio::time::sleep(Duration::from_millis(600 + 70 * u64::from(round))).await;
        disk.free();
        tokio::time::sleep(Duration::from_millis(450)).await;
    }
    let streamed = in_time(streaming).await;
    let outcomes = streamed.unwrap_or_else(|error| panic!("{error}\n{}", first_lines(&server.log())));
    for (expected, outcome) in (1..).zip(&outcomes) {
        match outcome {
            FrameOutcome::Answer(answer) => assert_eq!(answer.sequence, expected),
            FrameOutcome::Refusal(refusal) => panic!("frame {expected} was lost: {refusal:?}"),
        }
    }
    assert!(server.log().contains("disk full"), "the disk was never full");
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, frames);
    assert_eq!(map.state_hash, Some(reference().maps[frames as usize].state_hash.clone()));
    server.stop();
}

/// What is left of a disk is the robots'.
#[tokio::test(flavor = "multi_thread")]
async fn an_import_is_refused_before_the_disk_is_full() {
    let Some(disk) = SmallDisk::mount(DISK_MIB) else { return };
    let (server, client) = serving(&disk.folder()).await;
    let mut snapshot = Vec::new();
    client.export_map("drive", &mut snapshot).await.unwrap();
    let refusal = client.import_map("copy", std::io::Cursor::new(snapshot)).await;
    let (code, message) = refused(refusal);
    assert_status("an import", (code, &message), Code::Unavailable, "disk is full and nothing was stored");
    assert_eq!(client.maps().await.unwrap().len(), 1);
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert!(!raw.answered(wire(frame(1))).await.resent);
    server.stop();
}

/// How the trouble began.
fn first_lines(log: &str) -> String {
    log.lines().take(20).collect::<Vec<_>>().join("\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_that_finds_no_room_leaves_nothing_and_says_why() {
    let Some(disk) = SmallDisk::mount(DISK_MIB) else { return };
    let (data, target) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    serving(data.path()).await.0.stop();
    let backup = target.path().join("backup");
    let run = |data: &Path, arguments: [&str; 2]| {
        let mut command = Built::command("waypost-server");
        command.arg("--data-dir").arg(data).args(arguments);
        let Output { status, stderr, .. } = run_to_its_end(command);
        (status.code(), String::from_utf8(stderr).unwrap())
    };
    let (code, said) = run(data.path(), ["backup", path(&backup)]);
    assert_eq!(code, Some(0), "{said}");
    std::fs::create_dir(disk.folder()).unwrap();
    disk.fill();
    let restore = ["restore", path(&backup)];
    let (code, said) = run(&disk.folder(), restore);
    assert!(code == Some(1) && said.contains("the disk is full; free some space"), "{said}");
    assert!(!disk.folder().join("waypost.sqlite.partial").exists(), "a part of it is left");
    disk.free();
    let (code, said) = run(&disk.folder(), restore);
    assert_eq!(code, Some(0), "{said}");
}
