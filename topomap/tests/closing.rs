//! What closes a loop by words alone, what links it, and which frames are refused.

use crate::words::WORDS;
use fabmap::PlaceId;
use fabmap::observation::Observation;
use topomap::log::{LinkKind, MapEvent, Reason};
use topomap::mapper::{FrameError, FrameInput};
use topomap::metric::Odometry;

use crate::drives::{Robot, odometry, one_frame};

#[test]
fn a_round_closes_where_it_began() {
    let mut robot = Robot::new();
    let mut reasons = Vec::new();
    for (step, place) in (1..).zip([1, 2, 3, 4, 5, 6, 1, 1, 1, 1, 1, 2]) {
        reasons.push(robot.see(one_frame(0, step, step as i64, place)).decision.reason);
    }
    assert_eq!(reasons[..6], [Reason::NewPlace; 6]);
    assert_eq!(reasons[6], Reason::LoopClosure);
    assert_eq!(reasons[7..11], [Reason::SamePlace; 4]);
    assert_eq!(reasons[11], Reason::LoopClosure);
    let map = robot.mapper.map();
    assert_eq!(map.links().len(), 6, "the chain of six places and the link that closes it");
    assert_eq!(map.linked(PlaceId::new(0)), [1, 5].map(PlaceId::new));
    // Two visits: one look of the first, at most three of the second.
    assert_eq!(robot.mapper.recognizer().index().appearance(PlaceId::new(0)).unwrap().looks(), 4);
}

#[test]
fn a_closure_names_the_frame_that_matched() {
    let mut robot = Robot::new();
    for (step, place) in (1..).zip([1, 2, 3, 4, 5, 6]) {
        robot.see(one_frame(0, step, step as i64, place));
    }
    let event = robot.see(one_frame(0, 7, 7, 2));
    let closure = event.decision.closure.unwrap();
    // Position 0 of the log is the session's opening, so the second frame is at 2.
    assert_eq!(
        (event.decision.reason, closure.place, closure.frame),
        (Reason::LoopClosure, PlaceId::new(1), 2)
    );
    assert_eq!(event.proposal, Some(closure));
    assert!(closure.posterior > 0.999 && closure.log_odds > 7.0);
}

#[test]
fn a_frame_without_words_changes_no_place_and_no_belief() {
    let mut robot = Robot::new();
    let first = robot.see(one_frame(0, 1, 1, 1));
    let dark = FrameInput { observation: Observation::default(), ..one_frame(0, 2, 2, 1) };
    let event = robot.see(dark);
    assert_eq!(
        (event.decision.reason, event.decision.place, event.proposal),
        (Reason::TooFewWords, None, None)
    );
    assert_eq!(event.belief, first.belief);
    assert_eq!(robot.mapper.recognizer().places(), 1);
    assert_eq!(robot.see(one_frame(0, 3, 3, 1)).decision.reason, Reason::SamePlace);
}

#[test]
fn another_robot_closes_on_the_first_ones_places_at_once() {
    let mut robot = Robot::new();
    for (step, place) in (1..).zip([1, 2, 3]) {
        robot.see(one_frame(0, step, step as i64, place));
    }
    robot.fold(MapEvent::SessionOpened { session: 1 });
    assert_eq!(robot.see(one_frame(1, 1, 1, 2)).decision.reason, Reason::LoopClosure);
}

#[test]
fn odometry_measures_the_links_it_saw() {
    let mut robot = Robot::new();
    let with = |step: u64| FrameInput {
        odometry: Some(odometry(step)),
        ..one_frame(0, step, step as i64 * 1_000_000_000, step)
    };
    robot.see(with(1));
    let link = robot.see(with(2)).link.unwrap();
    let LinkKind::Driven(measured) = link.kind else { panic!("{link:?}") };
    assert!((measured.pose().x_m().hypot(measured.pose().y_m()) - 0.5).abs() < 1e-12);
    assert!(measured.covariance().symmetric_eigenvalues().min() > 0.0);
    let without = FrameInput { odometry: None, ..with(3) };
    assert_eq!(robot.see(without).link.unwrap().kind, LinkKind::Session);
}

#[test]
fn frames_out_of_order_or_out_of_this_world_are_refused() {
    let mut robot = Robot::new();
    let at = |step: u64, x_m: f64| {
        let odometry = Odometry::new([x_m, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None).unwrap();
        FrameInput { odometry: Some(odometry), ..one_frame(0, step, step as i64 * 1_000_000_000, 1) }
    };
    robot.see(at(5, 0.0));
    assert!(matches!(robot.refusal(at(5, 0.0)), FrameError::SequenceNotRising { sequence: 5, last: 5 }));
    let early = FrameInput { stamp_ns: 4_000_000_000, ..at(6, 0.0) };
    assert!(matches!(robot.refusal(early), FrameError::StampNotRising { .. }));
    assert!(matches!(robot.refusal(at(6, 500.0)), FrameError::OdometryJump { .. }));
    assert!(matches!(robot.refusal(one_frame(9, 6, 6, 1)), FrameError::UnknownSession { session: 9 }));
    let foreign = Observation::from_words([WORDS], WORDS as usize + 1).unwrap();
    let foreign = FrameInput { observation: foreign, ..at(6, 0.0) };
    assert!(matches!(robot.refusal(foreign), FrameError::ForeignWord { word, .. } if word.number() == WORDS));
    robot.see(at(6, 0.5));
}
