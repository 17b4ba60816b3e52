//! Sessions against a server that breaks: every frame gets one outcome, in order, and is committed
//! once.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

use std::num::NonZeroUsize;
use std::time::Duration;

use futures::FutureExt;
use peer::{BAD_IMAGE_BYTES, Fault, MAP, Peer};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_client::{
    Client, Code, Error, FrameContent, FrameInput, FrameOutcome, Reconnection, Session, SessionOptions,
};

mod peer;

const SESSION: &str = "maps/office/sessions/run";

fn options() -> SessionOptions {
    let reconnection = Reconnection {
        first_delay: Duration::from_millis(2),
        longest_delay: Duration::from_millis(50),
        give_up_after: Duration::from_secs(30),
    };
    SessionOptions { session_id: "run".to_owned(), reconnection, ..SessionOptions::new(MAP) }
}

fn frame(sequence: u64) -> FrameInput {
    FrameInput {
        sequence,
        stamp_ns: sequence as i64,
        content: FrameContent::Image(vec![0xff; 64]),
        odometry: None,
        note: String::new(),
    }
}

async fn open(peer: &Peer, options: SessionOptions) -> Session {
    Client::lazy(&peer.endpoint()).unwrap().open_session(options).await.unwrap()
}

/// Sends frames and gathers all outcomes, up to an error if there is one.
async fn run(session: Session, frames: Vec<FrameInput>) -> (Vec<FrameOutcome>, Result<(), Error>) {
    let (mut sender, mut outcomes) = session.split();
    let sending = tokio::spawn(async move {
        for frame in frames {
            if sender.send(frame).await.is_err() {
                break;
            }
        }
    });
    let mut gathered = Vec::new();
    let ending = loop {
        match outcomes.next().await {
            Ok(Some(outcome)) => gathered.push(outcome),
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    sending.await.unwrap();
    (gathered, ending)
}

fn sequences(outcomes: &[FrameOutcome]) -> Vec<u64> {
    outcomes.iter().map(FrameOutcome::sequence).collect()
}

fn answered(outcomes: &[FrameOutcome]) -> Vec<u64> {
    let answers = outcomes.iter().filter(|outcome| matches!(outcome, FrameOutcome::Answer(_)));
    answers.map(FrameOutcome::sequence).collect()
}

fn refusal_code(outcome: &FrameOutcome) -> Option<Code> {
    match outcome {
        FrameOutcome::Refusal(refusal) => refusal.status.as_ref().map(|status| Code::from(status.code)),
        FrameOutcome::Answer(_) => None,
    }
}

fn is_resent(outcome: &FrameOutcome) -> bool {
    matches!(outcome, FrameOutcome::Answer(answer) if answer.resent)
}

/// Streams 20 frames through the faults and checks that nothing of them shows.
async fn survives(faults: Vec<(u64, Fault)>) -> (Peer, Vec<FrameOutcome>) {
    let peer = Peer::start(faults.clone());
    let session = open(&peer, options()).await;
    let (outcomes, ending) = run(session, (1..=20).map(frame).collect()).await;
    ending.unwrap_or_else(|error| panic!("{faults:?}: {error}"));
    let all: Vec<u64> = (1..=20).collect();
    assert_eq!(answered(&outcomes), all, "{faults:?}");
    assert_eq!(peer.record().committed[SESSION], all, "{faults:?}");
    (peer, outcomes)
}

#[tokio::test]
async fn an_undisturbed_session_uses_one_stream() {
    let (peer, outcomes) = survives(vec![]).await;
    assert_eq!(peer.record().opened, [SESSION]);
    assert!(!outcomes.iter().any(is_resent));
}

#[tokio::test]
async fn a_crash_before_the_commit_loses_nothing() {
    let (peer, _) = survives(vec![(7, Fault::CrashBeforeCommit)]).await;
    assert!(peer.record().opened.len() > 1);
}

#[tokio::test]
async fn an_answer_lost_after_the_commit_comes_from_the_store() {
    let (peer, outcomes) = survives(vec![(7, Fault::CrashAfterCommit)]).await;
    assert!(peer.record().opened.len() > 1);
    assert!(is_resent(&outcomes[6]), "{:?}", outcomes[6]);
}

#[tokio::test]
async fn a_stream_that_ends_early_is_opened_again() {
    let ends = [
        Fault::End(Code::Unavailable),
        Fault::EndQuietly,
        Fault::End(Code::ResourceExhausted),
        Fault::End(Code::Cancelled),
        Fault::End(Code::Unknown),
    ];
    let (peer, _) = survives((3..).zip(ends).collect()).await;
    assert_eq!(peer.record().opened.len(), 6);
}

#[tokio::test]
async fn frames_refused_for_now_are_sent_again() {
    let (peer, _) =
        survives(vec![(20, Fault::Refuse(Code::ResourceExhausted)), (20, Fault::Refuse(Code::Unavailable))])
            .await;
    assert_eq!(peer.record().opened.len(), 1);
}

/// As when a server drops a map after a commit that failed: all that is on its way is refused.
#[tokio::test]
async fn a_burst_of_refusals_is_sent_again_in_order() {
    let refusals = (1..=8).map(|sequence| (sequence, Fault::Refuse(Code::Unavailable)));
    let peer = Peer::start(refusals);
    let (outcomes, ending) = run(open(&peer, options()).await, (1..=8).map(frame).collect()).await;
    ending.unwrap();
    assert_eq!(answered(&outcomes), (1..=8).collect::<Vec<_>>());
    assert_eq!(peer.record().committed[SESSION], (1..=8).collect::<Vec<_>>());
    assert_eq!(peer.record().opened.len(), 1);
}

#[tokio::test]
async fn any_order_of_faults_is_survived() {
    let kinds =
        [Fault::CrashBeforeCommit, Fault::CrashAfterCommit, Fault::End(Code::Unavailable), Fault::EndQuietly];
    for seed in 0..25 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let faults = (0..random.random_range(1..=6))
            .map(|_| (random.random_range(1..=20), kinds[random.random_range(0..kinds.len())].clone()))
            .collect();
        survives(faults).await;
    }
}

#[tokio::test]
async fn a_frame_refused_for_good_is_handed_over_in_its_turn() {
    let peer = Peer::start([(4, Fault::CrashAfterCommit)]);
    let mut frames: Vec<FrameInput> = (1..=6).map(frame).collect();
    frames[2].content = FrameContent::Image(vec![0xff; BAD_IMAGE_BYTES]);
    let (outcomes, ending) = run(open(&peer, options()).await, frames).await;
    ending.unwrap();
    assert_eq!(sequences(&outcomes), [1, 2, 3, 4, 5, 6]);
    assert_eq!(answered(&outcomes), [1, 2, 4, 5, 6]);
    assert_eq!(refusal_code(&outcomes[2]), Some(Code::InvalidArgument));
}

/// Frame 3 was to be sent again, but 4 and 5 were on their way already.
#[tokio::test]
async fn a_frame_that_was_overtaken_keeps_its_turn() {
    let peer = Peer::start([(3, Fault::Refuse(Code::Unavailable))]);
    let (outcomes, ending) = run(open(&peer, options()).await, (1..=9).map(frame).collect()).await;
    ending.unwrap();
    assert_eq!(sequences(&outcomes), (1..=9).collect::<Vec<_>>());
    let log = &peer.record().committed[SESSION];
    assert!(log.is_sorted(), "{log:?}");
    assert!(log.contains(&3) || refusal_code(&outcomes[2]) == Some(Code::FailedPrecondition));
}

#[tokio::test]
async fn what_the_server_decides_is_not_tried_again() {
    let codes = [
        Code::Aborted,
        Code::NotFound,
        Code::FailedPrecondition,
        Code::InvalidArgument,
        Code::PermissionDenied,
    ];
    for expected in codes {
        let peer = Peer::start([(5, Fault::End(expected))]);
        let (outcomes, ending) = run(open(&peer, options()).await, (1..=20).map(frame).collect()).await;
        assert_eq!(sequences(&outcomes), [1, 2, 3, 4]);
        let Err(Error::Status { code, message }) = ending else { panic!("{ending:?}") };
        assert_eq!((code, message.as_str()), (expected, "the script says so"));
        assert_eq!(peer.record().opened.len(), 1);
    }
}

#[tokio::test]
async fn an_unknown_map_is_told_when_opening() {
    let peer = Peer::start([]);
    let client = Client::connect(&peer.endpoint()).await.unwrap();
    let refused = client.open_session(SessionOptions::new("nowhere")).await;
    assert!(matches!(&refused, Err(Error::Status { code: Code::NotFound, .. })), "{refused:?}");
}

#[tokio::test]
async fn a_server_that_stays_away_is_given_up() {
    let mut peer = Peer::start([]);
    let mut options = options();
    options.reconnection.give_up_after = Duration::from_millis(300);
    let mut session = open(&peer, options).await;
    session.send(frame(1)).await.unwrap();
    assert!(matches!(session.next().await, Ok(Some(FrameOutcome::Answer(_)))));
    peer.stop();
    for sequence in 2..=4 {
        session.send(frame(sequence)).await.unwrap();
    }
    let lost = session.next().await;
    let Err(Error::SessionLost { unacknowledged, waited, .. }) = lost else { panic!("{lost:?}") };
    assert_eq!(unacknowledged, 3);
    assert!(waited >= Duration::from_millis(300), "{waited:?}");
    assert!(matches!(session.next().await, Ok(None)));
    assert!(matches!(session.send(frame(5)).await, Err(Error::SessionEnded { sequence: 5 })));
}

#[tokio::test]
async fn a_frame_that_is_never_taken_is_given_up() {
    let refusals = std::iter::repeat_n((2, Fault::Refuse(Code::ResourceExhausted)), 1000);
    let peer = Peer::start(refusals);
    let mut options = options();
    options.reconnection.give_up_after = Duration::from_millis(300);
    let (outcomes, ending) = run(open(&peer, options).await, vec![frame(1), frame(2)]).await;
    assert_eq!(answered(&outcomes), [1]);
    let Err(Error::SessionLost { unacknowledged: 1, reason, .. }) = &ending else { panic!("{ending:?}") };
    assert_eq!(reason, "the script says so");
}

#[tokio::test]
async fn a_server_that_forgot_acknowledged_frames_is_noticed() {
    let peer = Peer::start([(5, Fault::CrashAndForget)]);
    let mut session = open(&peer, options()).await;
    for sequence in 1..=4 {
        session.send(frame(sequence)).await.unwrap();
        assert!(matches!(session.next().await, Ok(Some(FrameOutcome::Answer(_)))));
    }
    session.send(frame(5)).await.unwrap();
    let rewound = session.next().await;
    assert!(
        matches!(rewound, Err(Error::SessionRewound { acknowledged: 4, last_committed: None })),
        "{rewound:?}"
    );
}

#[tokio::test]
async fn a_name_that_the_server_made_up_is_kept() {
    let peer = Peer::start([(2, Fault::CrashAfterCommit), (3, Fault::CrashBeforeCommit)]);
    let session = open(&peer, SessionOptions { session_id: String::new(), ..options() }).await;
    let name = session.opened().session.clone();
    let (outcomes, ending) = run(session, (1..=5).map(frame).collect()).await;
    ending.unwrap();
    assert_eq!(answered(&outcomes), [1, 2, 3, 4, 5]);
    let record = peer.record();
    assert!(record.opened.len() > 1 && record.opened.iter().all(|opened| *opened == name));
    assert_eq!(record.committed[&name], [1, 2, 3, 4, 5]);
}

#[tokio::test]
async fn a_session_is_resumed_where_it_was() {
    let peer = Peer::start([]);
    let first = open(&peer, options()).await;
    assert_eq!(first.opened().last_committed_sequence, None);
    run(first, vec![frame(1), frame(5)]).await.1.unwrap();
    let second = open(&peer, options()).await;
    assert_eq!(second.opened().last_committed_sequence, Some(5));
    let (outcomes, ending) = run(second, vec![frame(5), frame(6)]).await;
    ending.unwrap();
    assert!(is_resent(&outcomes[0]) && !is_resent(&outcomes[1]));
    assert_eq!(peer.record().committed[SESSION], [1, 5, 6]);
}

#[tokio::test]
async fn sending_waits_while_the_window_is_full() {
    let peer = Peer::start([]);
    peer.hold_answers();
    let window_frames = NonZeroUsize::new(3).unwrap();
    let mut session = open(&peer, SessionOptions { window_frames, ..options() }).await;
    for sequence in 1..=3 {
        session.send(frame(sequence)).await.unwrap();
    }
    assert!(session.send(frame(4)).now_or_never().is_none());
    while peer.record().most_held < 3 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    peer.release_answers();
    session.send(frame(4)).await.unwrap();
    session.finish();
    let (outcomes, ending) = run(session, vec![]).await;
    ending.unwrap();
    assert_eq!(answered(&outcomes), [1, 2, 3, 4]);
    assert_eq!(peer.record().most_held, 3);
}

#[tokio::test]
async fn numbers_have_to_rise() {
    let peer = Peer::start([]);
    let mut session = open(&peer, options()).await;
    session.send(frame(3)).await.unwrap();
    for sequence in [3, 2] {
        let refused = session.send(frame(sequence)).await;
        assert!(matches!(refused, Err(Error::SequenceNotRising { last: 3, .. })), "{refused:?}");
    }
    session.send(frame(4)).await.unwrap();
    session.finish();
    assert!(matches!(session.send(frame(5)).await, Err(Error::SessionEnded { sequence: 5 })));
    let (outcomes, ending) = run(session, vec![]).await;
    ending.unwrap();
    assert_eq!(answered(&outcomes), [3, 4]);
}

#[tokio::test]
async fn a_robot_may_boot_before_its_server() {
    let mut gone = Peer::start([]);
    let endpoint = gone.endpoint();
    gone.stop();
    let mut options = options();
    options.reconnection.give_up_after = Duration::from_millis(100);
    let lost = Client::lazy(&endpoint).unwrap().open_session(options).await;
    assert!(matches!(lost, Err(Error::SessionLost { unacknowledged: 0, .. })), "{lost:?}");
    let unreachable = Client::connect(&endpoint).await;
    assert!(matches!(unreachable, Err(Error::Connection { .. })), "{unreachable:?}");
}
