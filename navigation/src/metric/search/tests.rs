use fabmap::PlaceId;
use proptest::prelude::*;

use super::*;
use topomap::evidence::VerificationSettings;

const TRUTH: [f64; 3] = [3.0, -1.0, 0.4];

fn closure(pose: PlanarPose, evidence: f64) -> Closure {
    let covariance = Matrix3::from_diagonal(&Vector3::new(0.02, 0.006, 0.001));
    let at = MapPosition { part: PlaceId::new(0), pose };
    let from_view = PlanarPose::identity();
    Closure {
        place: PlaceId::new(7),
        frame: 1,
        at,
        from_view,
        covariance,
        probability: 0.9,
        evidence: Some(evidence),
    }
}

fn glimpses(closures: &[Closure]) -> Glimpses {
    let mut glimpses = [None; VerificationSettings::MAX_CANDIDATES];
    for (glimpse, closure) in glimpses.iter_mut().zip(closures) {
        *glimpse = Some(*closure);
    }
    glimpses
}

/// One turn on the spot, twelve degrees a frame, of a robot whose wheels began at `start`: of each
/// frame the poses that `seen` says for it, if it stands where `truth` says; what was found at
/// which frame.
fn turn(
    start: PlanarPose,
    seen: impl Fn(usize, PlanarPose) -> Vec<Closure>,
) -> Option<(usize, PlanarPose, Closure)> {
    let settings = LocalizationSettings::default();
    let mut search = Search::default();
    (0..30).find_map(|frame: usize| {
        let turned = PlanarPose::new(0.0, 0.0, 0.21 * frame as f64);
        let truth = PlanarPose::new(TRUTH[0], TRUTH[1], TRUTH[2]).compose(&turned);
        let found = search.see(&start.compose(&turned), None, &glimpses(&seen(frame, truth)), &settings)?;
        Some((frame, truth, found))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Weak views over a part of the turn are enough once it has looked all around, wherever its
    /// wheels began and whatever else it saw in single frames.
    #[test]
    fn weak_views_that_agree_tell_where_it_is_after_a_turn(
        x_m in -50.0..50.0f64, heading_rad in -3.0..3.0f64, first in 0..24usize,
        off in proptest::collection::vec((-0.3..0.3f64, -0.3..0.3f64, -0.1..0.1f64), 30),
    ) {
        let found = turn(PlanarPose::new(x_m, 2.0, heading_rad), |frame, truth| {
            let (along_m, across_m, turn_rad) = off[frame];
            let poor = truth.compose(&PlanarPose::new(along_m, across_m, turn_rad));
            let elsewhere = PlanarPose::new(10.0 + 5.0 * frame as f64, 0.0, 1.0);
            let mut seen = vec![closure(elsewhere, 20.0)];
            if (first..first + 5).contains(&frame) {
                seen.push(closure(poor, 40.0));
            }
            seen
        });
        let (frame, truth, found) = found.unwrap();
        prop_assert!(frame >= 27, "not before it has looked all around: {frame}");
        let missed = found.at.pose.inverse().compose(&truth);
        prop_assert!(missed.x_m().hypot(missed.y_m()) < 0.3 && missed.heading_rad().abs() < 0.1, "{missed:?}");
    }
}

#[test]
fn where_as_much_speaks_for_elsewhere_nothing_is_found() {
    let start = PlanarPose::identity();
    let both = |frame: usize, truth: PlanarPose| match frame {
        5..9 => vec![closure(truth, 40.0)],
        // The same office two doors on.
        15..19 => vec![closure(PlanarPose::new(8.0, 0.0, 0.0).compose(&truth), 40.0)],
        _ => Vec::new(),
    };
    assert_eq!(turn(start, both), None);
    assert!(turn(start, |frame, truth| if frame < 9 { both(frame, truth) } else { Vec::new() }).is_some());
}

#[test]
fn a_robot_that_stands_finds_nothing_by_the_same_weak_view_again_and_again_and_clear_ones_tell_at_once() {
    let settings = LocalizationSettings::default();
    let odometry = PlanarPose::identity();
    let pose = PlanarPose::new(TRUTH[0], TRUTH[1], TRUTH[2]);
    let mut search = Search::default();
    let weak = closure(pose, settings.found_evidence - 1.0);
    for _ in 0..2 * MOST_FRAMES {
        assert_eq!(search.see(&odometry, Some(&weak), &glimpses(&[weak]), &settings), None);
    }
    let mut search = Search::default();
    let clear = closure(pose, settings.found_evidence);
    for _ in 1..settings.confirmations {
        assert_eq!(search.see(&odometry, Some(&clear), &glimpses(&[clear]), &settings), None);
    }
    let found = search.see(&odometry, Some(&clear), &glimpses(&[clear]), &settings).unwrap();
    assert!(is_within(&found.at.pose, &pose, (1e-9, 1e-9)));
    // Words alone count as clear.
    let words = Closure { evidence: None, ..clear };
    let mut search = Search::default();
    let mut see = || search.see(&odometry, Some(&words), &glimpses(&[]), &settings);
    assert!((1..settings.confirmations).all(|_| see().is_none()));
    assert!(see().is_some());
}
