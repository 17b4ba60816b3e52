//! Frames that wait for a quota: for their turn, or for room.

use std::time::{Duration, Instant};

use reqwest::StatusCode;
use waypost_client::v1::quotas::Kind;
use waypost_client::{Client, Code, FrameOutcome, v1};
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use super::Guarded;
use super::quotas::{limited, robot, told, used};
use crate::harness::{
    Answer, RawStream, answers, as_words, assert_status, frame, http, images, in_time, open, reference,
    refused, session_options, state_hash, wire,
};

async fn lift(admin: &Client, kind: Kind) -> v1::Token {
    let request = v1::UpdateTokenRequest {
        name: "robot-7".to_owned(),
        lifted: vec![kind.into()],
        ..Default::default()
    };
    admin.update_token(request).await.unwrap()
}

/// A stream that shows a secret, message by message.
async fn raw_stream(guarded: &Guarded, secret: &str, session: &str) -> RawStream {
    let first = Request::Open(open("drive", session));
    let mut stream = RawStream::begin_as(&guarded.server.endpoint(), secret, first).await.unwrap();
    let Ok(Some(Response::Opened(_))) = stream.next().await else { panic!("not opened") };
    stream
}

#[tokio::test(flavor = "multi_thread")]
async fn two_streams_of_one_token_share_its_frames_a_second() {
    const FRAMES: u64 = 12;
    const PER_SECOND: f64 = 6.0;
    let guarded = Guarded::start().await;
    let quotas = v1::Quotas { max_frames_per_second: Some(PER_SECOND), ..Default::default() };
    let robot = robot(&guarded, quotas).await;
    let begun = Instant::now();
    let drive = async |session: &str| {
        let answered = answers(&robot, "drive", session, (1..=FRAMES).map(as_words)).await;
        (answered.iter().map(|answer| answer.sequence).collect::<Vec<_>>(), begun.elapsed())
    };
    let ((one, one_took), (two, two_took)) = tokio::join!(drive("one"), drive("two"));
    let all: Vec<u64> = (1..=FRAMES).collect();
    assert_eq!((&one, &two), (&all, &all), "each frame has one answer, in order");
    // What one second saved may come at once.
    let least = Duration::from_secs_f64((2.0 * FRAMES as f64 - PER_SECOND) / PER_SECOND - 0.1);
    let (first, last) = (one_took.min(two_took), one_took.max(two_took));
    assert!(last >= least && last < least + Duration::from_secs(6), "{last:?} of {least:?}");
    assert!(first > last / 2, "one stream had it all: {first:?} and {last:?}");
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_above_the_rate_hears_when_to_come_and_those_behind_it_wait() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let quotas = v1::Quotas { max_frames_per_second: Some(0.25), ..Default::default() };
    let (_, secret) = admin.create_limited_token(limited("robot-7", quotas)).await.unwrap();
    let mut stream = raw_stream(&guarded, &secret, "tour").await;
    stream.answered(wire(frame(1))).await;
    let refusal = stream.refused(wire(frame(2))).await;
    let (code, message, retry) = told(&refusal);
    let says = "the token robot-7 has sent the 0.25 frames a second that it may (max_frames_per_second)";
    assert_status("above", (code, &message), Code::ResourceExhausted, says);
    assert_eq!(refusal.last_committed_sequence, Some(1), "it was not acknowledged");
    let behind = stream.refused(wire(frame(3))).await;
    let (code, message, _) = told(&behind);
    assert_status("behind", (code, &message), Code::Unavailable, "frame 2 must be sent again first");
    // A query is a frame, too, and stands behind the stream that has its turn.
    let query = http().post(guarded.server.url("/v1/maps/drive/query")).bearer_auth(&secret);
    let query = Answer::to(query.header("content-type", "image/jpeg").body(images()[0].clone())).await;
    assert_eq!(query.status, StatusCode::TOO_MANY_REQUESTS, "{}", query.text());
    assert!(query.text().contains(says) && !query.header("retry-after").is_empty(), "{}", query.text());
    tokio::time::sleep(retry.unwrap()).await;
    stream.answered(wire(frame(2))).await;
    // One that was answered is not counted again.
    assert!(stream.answered(wire(frame(2))).await.resent);
    lift(&admin, Kind::FramesPerSecond).await;
    for sequence in 3..=6 {
        stream.answered(wire(frame(sequence))).await;
    }
    guarded.server.stop().await;
}

/// Who holds no stream open keeps no place in line: each frame that comes when the quota has room is taken.
#[tokio::test(flavor = "multi_thread")]
async fn frames_one_by_one_of_two_sessions_are_all_taken() {
    const FRAMES: u64 = 4;
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let quotas = v1::Quotas { max_frames_per_second: Some(2.0), ..Default::default() };
    let (_, secret) = admin.create_limited_token(limited("robot-7", quotas)).await.unwrap();
    let drive = async |session: &str| {
        let mut refusals = 0;
        for number in 1..=FRAMES {
            loop {
                let path = format!("/v1/maps/drive/sessions/{session}/frames/{number}?stamp_ns={number}");
                let put = http().put(guarded.server.url(&path)).bearer_auth(&secret);
                let image = images()[number as usize].clone();
                let answer = Answer::to(put.header("content-type", "image/jpeg").body(image)).await;
                if answer.status == StatusCode::OK {
                    break;
                }
                assert_eq!(answer.status, StatusCode::TOO_MANY_REQUESTS, "{}", answer.text());
                refusals += 1;
                let seconds: u64 = answer.header("retry-after").parse().unwrap();
                tokio::time::sleep(Duration::from_secs(seconds)).await;
            }
        }
        refusals
    };
    let (one, two) = in_time(async { tokio::join!(drive("one"), drive("two")) }).await;
    let refusals = one + two;
    assert!((1..=4 * FRAMES).contains(&refusals), "{one} and {two} were refused, of {FRAMES} frames each");
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_waits_for_room_and_goes_on_without_loss_once_its_quota_is_lifted() {
    const FRAMES: u64 = 24;
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let robot = robot(&guarded, v1::Quotas { max_kept_mib: Some(1), ..Default::default() }).await;
    let mut session = robot.open_session(session_options("drive", "tour")).await.unwrap();
    for sequence in 1..=FRAMES {
        session.send(frame(sequence)).await.unwrap();
    }
    let mut taken = 0;
    while let Ok(outcome) = tokio::time::timeout(Duration::from_secs(2), session.next()).await {
        match outcome.unwrap() {
            Some(FrameOutcome::Answer(answer)) => taken = answer.sequence,
            other => panic!("{other:?}"),
        }
    }
    assert!((2..FRAMES).contains(&taken), "{taken} frames are a mebibyte");
    let kept = used(&admin, "tokens/robot-7").await.kept_bytes;
    assert!((900_000..=1 << 20).contains(&kept), "{kept} bytes are kept");
    assert_eq!(admin.session("maps/drive/sessions/tour").await.unwrap().kept_bytes, kept);

    lift(&admin, Kind::Kept).await;
    session.finish();
    while let Some(outcome) = in_time(session.next()).await.unwrap() {
        let FrameOutcome::Answer(answer) = outcome else { panic!("{outcome:?}") };
        assert_eq!(answer.sequence, taken + 1);
        taken += 1;
    }
    assert_eq!(taken, FRAMES);
    assert_eq!(state_hash(&admin, "drive").await, reference().maps[FRAMES as usize].state_hash);

    // Below what is there, it takes nothing away, and a session keeps something, too.
    let request = v1::UpdateTokenRequest {
        name: "robot-7".to_owned(),
        quotas: Some(v1::Quotas { max_kept_mib: Some(1), ..Default::default() }),
        ..Default::default()
    };
    admin.update_token(request).await.unwrap();
    assert_eq!(admin.session("maps/drive/sessions/tour").await.unwrap().frames, FRAMES);
    // A session keeps something, too.
    let (code, message) =
        refused(in_time(robot.open_session(session_options("drive", "more"))).await.map(drop));
    let says = "of the 1 MiB in its sessions that it may (max_kept_mib); delete sessions";
    assert_status("another session", (code, &message), Code::FailedPrecondition, says);
    guarded.server.stop().await;
}
