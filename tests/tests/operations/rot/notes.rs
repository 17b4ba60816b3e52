//! What robots call their frames is stored beside the log, and its rot is found as that of the log is.

use waypost_client::{Code, FrameOutcome, v1};

use super::{deep, export, flip_at, note, two_maps};
use crate::harness::{Server, assert_status, frame, in_time, refused, session_options};

#[tokio::test(flavor = "multi_thread")]
async fn rotten_notes_are_found_wherever_they_are_told() {
    let directory = two_maps().await;
    flip_at(directory.path(), note(7).as_bytes());
    let found = deep(directory.path()).await;
    assert!(found.iter().any(|line| line.contains("map drive, what its frames are called")), "{found:?}");

    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let first = "maps/drive/sessions/first";
    let (code, message) = refused(client.frames_called(first, &note(7)).await);
    assert_status("by its note", (code, &message), Code::DataLoss, "map drive");
    let (code, message) = refused(client.frames(first).await);
    assert_status("frames", (code, &message), Code::DataLoss, "map drive");
    let mut watch = client.watch_map("drive", Some(0)).await.unwrap();
    let (code, message) = refused(in_time(watch.next()).await);
    assert_status("a watch", (code, &message), Code::DataLoss, "map drive");
    let (code, message) = refused(export(&client, "drive").await);
    assert_status("an export", (code, &message), Code::DataLoss, "map drive");
    let opened = client.open_session(session_options("drive", "third")).await;
    let (code, message) = refused(opened.map(drop));
    assert_status("a session", (code, &message), Code::FailedPrecondition, "takes nothing more");
    // What has no notes beside it is told.
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, 32);
    server.stop().await;
}

/// Found by a robot's frame that would be compared with the damaged one, and not only by who asks for that.
#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_needs_a_damaged_one_is_not_decided_without_it() {
    let directory = two_maps().await;
    flip_at(directory.path(), note(7).as_bytes());
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let (mut sender, mut outcomes) =
        client.open_session(session_options("drive", "third")).await.unwrap().split();
    for sequence in 1..=5 {
        sender.send(frame(sequence)).await.unwrap();
    }
    let Ok(Some(FrameOutcome::Refusal(refusal))) = in_time(outcomes.next()).await else {
        panic!("a frame was decided without what it is to be compared with")
    };
    let status = refusal.status.unwrap();
    assert_status("a frame", (Code::from(status.code), &status.message), Code::DataLoss, "map drive");
    server.stop().await;
}
