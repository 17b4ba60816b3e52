use proptest::prelude::*;

use super::*;
use topomap::evidence::VerificationSettings;

fn closure(pose: PlanarPose) -> Closure {
    let covariance = Matrix3::from_diagonal(&Vector3::new(0.02, 0.006, 0.001));
    let at = MapPosition { part: PlaceId::new(0), pose };
    let from_view = PlanarPose::identity();
    Closure {
        place: PlaceId::new(0),
        frame: 1,
        at,
        from_view,
        covariance,
        probability: 0.99,
        evidence: Some(100.0),
    }
}

fn see(
    filter: &mut PoseFilter,
    closure: &Closure,
    when: (i64, &PlanarPose),
    settings: &LocalizationSettings,
) -> Seen {
    let mut glimpses = [None; VerificationSettings::MAX_CANDIDATES];
    glimpses[0] = Some(*closure);
    filter.see((Some(closure), &glimpses), when, settings)
}

/// A drive along a wavy way: truth and wheels that are off by `drift_rad_per_m` and `scale`.
fn drive(drift_rad_per_m: f64, scale: f64) -> Vec<(i64, PlanarPose, PlanarPose)> {
    let mut truth = PlanarPose::new(3.0, 1.0, 0.5);
    let mut wheels = PlanarPose::identity();
    let step = |number: i64| {
        let turn_rad = 0.01 * (number as f64 / 40.0).sin();
        truth = truth.compose(&PlanarPose::new(0.02, 0.0, turn_rad));
        wheels =
            wheels.compose(&PlanarPose::new(0.02 * (1.0 + scale), 0.0, turn_rad + 0.02 * drift_rad_per_m));
        (number * 50_000_000, truth, wheels)
    };
    (1..1000).map(step).collect()
}

fn found(settings: &LocalizationSettings, drive: &[(i64, PlanarPose, PlanarPose)]) -> PoseFilter {
    let mut filter = PoseFilter::new(settings);
    let needed = settings.confirmations as usize;
    for (number, (stamp_ns, truth, wheels)) in drive[..needed].iter().enumerate() {
        let expected = if number + 1 < needed { Seen::Unconfirmed } else { Seen::Found };
        assert_eq!(see(&mut filter, &closure(*truth), (*stamp_ns, wheels), settings), expected);
    }
    filter
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn wheels_are_learnt(drift in -0.1..0.1f64, scale in -0.08..0.08f64) {
        let settings = LocalizationSettings::default();
        let drive = drive(drift, scale);
        let mut filter = found(&settings, &drive);
        let (seen, blind) = drive[settings.confirmations as usize..].split_at(900);
        for (stamp_ns, truth, wheels) in seen.iter().step_by(10) {
            prop_assert_eq!(see(&mut filter, &closure(*truth), (*stamp_ns, wheels), &settings), Seen::Corrected);
        }
        prop_assert!((filter.wheels.drift_rad_per_m - drift).abs() < 0.01, "{:?}", filter.wheels);
        prop_assert!((filter.wheels.scale - scale).abs() < 0.03, "{:?}", filter.wheels);
        // Nearly two metres without a closure.
        let (_, truth, wheels) = blind[blind.len() - 1];
        let missed = filter.at(&wheels, &settings).unwrap().pose.inverse().compose(&truth);
        prop_assert!(missed.x_m().hypot(missed.y_m()) < 0.1 && missed.heading_rad().abs() < 0.05, "{missed:?}");
    }

    /// What was seen counts for when it was seen, however late it is told.
    #[test]
    fn late_answers_say_the_same(late in 1..90usize, at in 10..500usize) {
        let settings = LocalizationSettings::default();
        let drive = drive(0.05, 0.02);
        let mut filter = found(&settings, &drive);
        let (stamp_ns, truth, wheels) = drive[at];
        prop_assert_eq!(see(&mut filter, &closure(truth), (stamp_ns, &wheels), &settings), Seen::Corrected);
        let later = drive[at + late].2;
        let told = filter.at(&later, &settings).unwrap();
        prop_assert!(told.position_sigma_m() > filter.at(&wheels, &settings).unwrap().position_sigma_m());
        // Older ones count no more.
        let (stamp_ns, truth, wheels) = drive[at - 5];
        prop_assert_eq!(see(&mut filter, &closure(truth), (stamp_ns, &wheels), &settings), Seen::Stale);
        prop_assert_eq!(filter.at(&later, &settings), Some(told));
    }
}

#[test]
fn one_contradiction_is_none_and_many_that_agree_are_a_kidnapping() {
    let settings = LocalizationSettings::default();
    let drive = drive(0.0, 0.0);
    let mut filter = found(&settings, &drive);
    let elsewhere = PlanarPose::new(20.0, -7.0, 1.0);
    let see = |filter: &mut PoseFilter, index: usize, jump: &PlanarPose| {
        let (stamp_ns, truth, wheels) = &drive[index];
        // Views that do not tell a lost robot where it is: these two views say little.
        let weak = Closure { evidence: Some(settings.least_evidence), ..closure(jump.compose(truth)) };
        super::tests::see(filter, &weak, (*stamp_ns, wheels), &settings)
    };
    assert_eq!(see(&mut filter, 10, &elsewhere), Seen::Unconfirmed);
    assert_eq!(see(&mut filter, 20, &PlanarPose::identity()), Seen::Corrected);
    for number in 0..10 {
        // Each somewhere else: they confirm nothing.
        let scattered = PlanarPose::new(9.0 * f64::from(number + 1), 0.0, 1.0);
        assert_eq!(see(&mut filter, 30 + number as usize, &scattered), Seen::Unconfirmed);
    }
    let last = settings.contradictions as usize;
    for number in 1..last {
        assert_eq!(see(&mut filter, 50 + 10 * number, &elsewhere), Seen::Unconfirmed);
    }
    assert_eq!(see(&mut filter, 50 + 10 * last, &elsewhere), Seen::Kidnapped);
    assert_eq!(filter.at(&drive[100].2, &settings), None);
}

#[test]
fn clear_views_that_agree_elsewhere_tell_at_once_where_it_was_put_down_and_weak_ones_tell_a_lost_robot_nothing()
 {
    let settings = LocalizationSettings::default();
    let drive = drive(0.0, 0.0);
    let mut filter = found(&settings, &drive);
    let elsewhere = PlanarPose::new(20.0, -7.0, 1.0);
    let mut see = |index: usize, evidence: f64| {
        let (stamp_ns, truth, wheels) = &drive[index];
        let closure = Closure { evidence: Some(evidence), ..closure(elsewhere.compose(truth)) };
        (
            super::tests::see(&mut filter, &closure, (*stamp_ns, wheels), &settings),
            filter.at(wheels, &settings),
        )
    };
    for number in 1..settings.confirmations as usize {
        assert_eq!(see(10 + number, settings.found_evidence).0, Seen::Unconfirmed);
    }
    let (seen, at) = see(20, settings.found_evidence);
    assert_eq!(seen, Seen::Found);
    let missed = elsewhere.compose(&drive[20].1).inverse().compose(&at.unwrap().pose);
    assert!(missed.x_m().hypot(missed.y_m()) < 0.1, "{missed:?}");

    let mut lost = PoseFilter::new(&settings);
    for (stamp_ns, truth, wheels) in &drive[..20] {
        let weak = Closure { evidence: Some(settings.found_evidence - 1.0), ..closure(*truth) };
        assert_eq!(super::tests::see(&mut lost, &weak, (*stamp_ns, wheels), &settings), Seen::Unconfirmed);
    }
    assert_eq!(lost.at(&drive[20].2, &settings), None);
}

#[test]
fn the_deviation_grows_with_the_way() {
    let settings = LocalizationSettings::default();
    let drive = drive(0.0, 0.0);
    let filter = found(&settings, &drive);
    let sigmas: Vec<f64> = drive
        .iter()
        .skip(2)
        .step_by(25)
        .map(|(.., wheels)| filter.at(wheels, &settings).unwrap().position_sigma_m())
        .collect();
    assert!(sigmas.windows(2).all(|pair| pair[0] < pair[1]), "{sigmas:?}");
}
