//! Frames sent again, gaps, and frames that come too late.

use waypost_client::{Code, v1};

use crate::harness::{RawStream, Server, answers, as_words, assert_status, frame, open, state_hash, wire};

fn stored(answer: &v1::FrameAnswer, last_committed: u64) -> v1::FrameAnswer {
    v1::FrameAnswer { last_committed_sequence: last_committed, timings: None, resent: true, ..answer.clone() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_sent_again_gets_the_stored_answer_and_changes_nothing() {
    const FRAMES: u64 = 12;
    let (server, client) = Server::with_map().await;
    let first = answers(&client, "drive", "robot", (1..=FRAMES).map(as_words)).await;
    let hash = state_hash(&client, "drive").await;

    let again = answers(&client, "drive", "robot", (1..=FRAMES).map(as_words)).await;
    let expected: Vec<v1::FrameAnswer> = first.iter().map(|answer| stored(answer, FRAMES)).collect();
    assert_eq!(again, expected);
    assert_eq!(state_hash(&client, "drive").await, hash);

    // The number is what counts, not what is in the frame.
    let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, Some(FRAMES));
    let other_image = v1::Frame { sequence: 3, ..wire(frame(9)) };
    assert_eq!(raw.answered(other_image).await, expected[2]);
    assert_eq!(state_hash(&client, "drive").await, hash);
    assert_eq!(client.map("drive", v1::MapView::Unspecified).await.unwrap().frames, FRAMES);
    server.stop().await;
}

/// Within one stream, and so fast that the first copy may not be on the disk when the second comes.
#[tokio::test(flavor = "multi_thread")]
async fn a_frame_sent_twice_in_a_row_is_stored_once() {
    use waypost_proto::v1::stream_request::Content::Frame;
    use waypost_proto::v1::stream_response::Content::Answer;

    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    for sequence in 1..=5 {
        raw.send(Frame(wire(frame(sequence)))).await;
        raw.send(Frame(wire(frame(sequence)))).await;
    }
    for sequence in 1..=5 {
        let (first, second) = (raw.next().await.unwrap(), raw.next().await.unwrap());
        let (Some(Answer(first)), Some(Answer(second))) = (first, second) else {
            panic!("frame {sequence} was refused")
        };
        assert_eq!((first.sequence, first.resent), (sequence, false));
        assert!(second.last_committed_sequence >= sequence);
        assert_eq!(second, stored(&first, second.last_committed_sequence));
    }
    assert_eq!(client.map("drive", v1::MapView::Unspecified).await.unwrap().frames, 5);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn gaps_are_fine_and_what_was_skipped_cannot_come_later() {
    let (server, client) = Server::with_map().await;
    let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(
        (opened.session.as_str(), opened.last_committed_sequence),
        ("maps/drive/sessions/robot", None)
    );
    for sequence in [2, 5, 9] {
        let answer = raw.answered(wire(frame(sequence))).await;
        assert_eq!((answer.sequence, answer.last_committed_sequence), (sequence, sequence));
    }
    let hash = state_hash(&client, "drive").await;
    for skipped in [1, 3, 8] {
        let refusal = raw.refused(wire(frame(skipped))).await;
        assert_eq!(refusal.sequence, skipped);
        let status = refusal.status.unwrap();
        assert_status(
            "skipped",
            (Code::from(status.code), &status.message),
            Code::FailedPrecondition,
            "was skipped",
        );
        assert!(
            status.message.contains(&skipped.to_string()) && status.message.contains('9'),
            "{}",
            status.message
        );
    }
    assert_eq!(state_hash(&client, "drive").await, hash);
    assert_eq!(raw.answered(wire(frame(10))).await.last_committed_sequence, 10);

    // So says another stream of the session, which knows the numbers from the store alone.
    drop(raw);
    let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, Some(10));
    let status = raw.refused(wire(frame(3))).await.status.unwrap();
    assert_status(
        "skipped",
        (Code::from(status.code), &status.message),
        Code::FailedPrecondition,
        "was skipped",
    );
    assert!(raw.answered(wire(frame(9))).await.resent);
    assert!(!raw.answered(wire(frame(11))).await.resent);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn sequence_number_0_and_the_largest_are_numbers_too() {
    const LARGEST: u64 = i64::MAX as u64;
    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    for (sequence, image) in [(0, 1), (LARGEST, 2)] {
        let numbered = v1::Frame { sequence, ..wire(frame(image)) };
        let first = raw.answered(numbered.clone()).await;
        assert_eq!(first.last_committed_sequence, sequence);
        assert_eq!(raw.answered(numbered).await, stored(&first, sequence));
    }
    let hash = state_hash(&client, "drive").await;
    let directory = server.directory().to_owned();
    let kept = tempfile::tempdir().unwrap();
    copy(&directory, kept.path());
    server.stop().await;

    // The copy was taken without a checkpoint of these frames: they are replayed.
    let server = Server::start_on(kept.path()).await;
    let client = server.client().await;
    assert_eq!(state_hash(&client, "drive").await, hash);
    let (_, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, Some(LARGEST));
    server.stop().await;
}

fn copy(from: &std::path::Path, to: &std::path::Path) {
    for file in std::fs::read_dir(from).unwrap() {
        let file = file.unwrap();
        std::fs::copy(file.path(), to.join(file.file_name())).unwrap();
    }
}
