//! Maps of the same places become one, others stay apart; and what both have seen is learnt once.

use crate::building::{
    Robot, WORDS, ahead, apart_m, first, judged, matches, model, model_of, plan, second, seen, unique,
};
use fabmap::appearance::{Appearance, PlaceId};
use posegraph::{PlanarPose, Pose};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::log::{MapEvent, Reason};
use topomap::mapper::Mapper;
use topomap::merging::{
    Apart, MergeError, MergeObserver, MergeSettings, PlaceMatch, Verdict, join, pairs_to_compare,
};
use topomap::metric::RelativePose;
use topomap::settings::MapperSettings;

/// Another one.
fn elsewhere(pose: &PlanarPose) -> PlanarPose {
    PlanarPose::new(pose.x_m() + 500.0, pose.y_m(), pose.heading_rad())
}

/// A building whose halls, ten metres each, all look the same.
fn repeated(pose: &PlanarPose) -> PlanarPose {
    PlanarPose::new(pose.x_m().rem_euclid(10.0), pose.y_m(), pose.heading_rad())
}

/// The same drive, of a robot whose wheels nobody reads.
fn without_metres(drive: impl Fn(&mut Robot), looks: crate::building::Looks, pose: PlanarPose) -> Robot {
    let mut robot = Robot::new(looks, pose, [0.0; 2]);
    robot.runs.get_mut(&0).unwrap().odometry = None;
    drive(&mut robot);
    robot
}

fn along(steps: usize) -> impl Fn(&mut Robot) {
    move |robot| ahead(robot, steps)
}

#[test]
fn maps_without_metres_are_joined_in_step() {
    let target = without_metres(along(30), unique, PlanarPose::new(0.1, 0.0, 0.0));
    let source = without_metres(along(30), unique, PlanarPose::new(9.1, 0.0, 0.0));
    let plan = plan(&source, &target);
    assert_eq!(plan.transformation, PlanarPose::identity());
    assert!(plan.fused.len() >= 10, "{} places fused", plan.fused.len());
    for fused in &plan.fused {
        let [a, b] = [source.made_at(fused.matched.source), target.made_at(fused.matched.target)];
        assert!(apart_m(&a, &b) < 1.3, "{fused:?}");
    }
    let joined = target.joined_by(&source, &plan);
    let [of_target, of_source] = [&target, &source].map(|robot| robot.mapper.map().places().len());
    assert_eq!(joined.mapper.map().places().len(), of_target + of_source - plan.fused.len());
    assert!(!joined.mapper.poses().has_metres());
    // The source's way goes on from the target's.
    let last = (of_target..joined.mapper.map().places().len()).map(PlaceId::from_index);
    assert!(
        last.clone().count() >= 10
            && last.into_iter().all(|place| !joined.mapper.map().linked(place).is_empty())
    );

    let other = without_metres(along(30), elsewhere, PlanarPose::new(9.1, 0.0, 0.0));
    assert!(matches!(judged(&other, &target, &matches(&other, &target)), Verdict::Apart(_)));
}

/// One map knows metres, the other none: the places that both have seen are joined all the same.
#[test]
fn a_map_without_metres_joins_one_with_them() {
    let target = first(unique);
    let source = without_metres(along(20), unique, PlanarPose::new(6.1, 0.0, 0.0));
    for (source, target) in [(&source, &target), (&target, &source)] {
        let plan = plan(source, target);
        assert!(plan.fused.len() >= 10, "{} places fused", plan.fused.len());
        let joined = target.joined_by(source, &plan);
        assert!(joined.mapper.poses().has_metres());
    }
}

/// Ten halls in a row that look the same, and a robot that has been in one of them.
#[test]
fn without_metres_too_halls_that_look_the_same_are_none_to_merge_by() {
    let made = |from_m: f64, steps: usize| {
        let mut robot = without_metres(along(steps), unique, PlanarPose::new(from_m, 0.0, 0.0));
        robot.looks = repeated;
        robot
    };
    let (target, source) = (made(0.1, 32), made(10.1, 12));
    let mut found = Vec::new();
    for place in PlaceId::first(source.mapper.map().places().len()) {
        for other in PlaceId::first(target.mapper.map().places().len()) {
            let view = seen(repeated, &target.made_at(other), &source.made_at(place));
            if view.motion.is_some() {
                let (source_frame, target_frame) = (1 + u64::from(place), 1 + u64::from(other));
                let (source, view, measured) = (place, Some(view), None);
                let matched = PlaceMatch {
                    source,
                    target: other,
                    source_frame,
                    target_frame,
                    posterior: 0.9,
                    view,
                    measured,
                };
                found.push(matched);
            }
        }
    }
    let verdict = judged(&source, &target, &found);
    assert!(matches!(verdict, Verdict::Apart(Apart::Ambiguous { .. })), "{verdict:?}");
}

impl Robot {
    /// Where the frame that made a place truly was.
    fn made_at(&self, place: PlaceId) -> PlanarPose {
        self.truth[self.mapper.map().places()[place.index()].frames[0].frame as usize]
    }
}

#[test]
fn two_maps_of_one_building_become_one() {
    let (target, source) = (first(unique), second(unique));
    let plan = plan(&source, &target);
    assert!(plan.fused.len() >= 15, "{} places fused", plan.fused.len());
    for fused in &plan.fused {
        let [a, b] = [source.made_at(fused.matched.source), target.made_at(fused.matched.target)];
        assert!(apart_m(&a, &b) < 0.6, "{fused:?}");
    }
    // The maps' frames are those of their first poses.
    let [a, b] = [source.truth[1], target.truth[1]];
    let truth = b.inverse().compose(&a);
    let missed = truth.inverse().compose(&plan.transformation);
    assert!(missed.x_m().hypot(missed.y_m()) < 0.6 && missed.heading_rad().abs() < 0.1, "{missed:?}");

    let joined = target.joined_by(&source, &plan);
    let (map, poses) = (joined.mapper.map(), joined.mapper.poses());
    let [of_target, of_source] = [&target, &source].map(|robot| robot.mapper.map().places().len());
    assert_eq!(map.places().len(), of_target + of_source - plan.fused.len());
    assert!(
        PlaceId::first(map.places().len()).all(|place| poses.part(place) == Some(PlaceId::new(0))),
        "one part"
    );
    let squares = PlaceId::first(map.places().len()).map(|place| {
        let was = joined.truth[1].inverse().compose(&joined.made_at(place));
        apart_m(&was, poses.pose(place).unwrap()).powi(2)
    });
    let rmse_m = (squares.sum::<f64>() / map.places().len() as f64).sqrt();
    assert!(rmse_m < 0.5, "{rmse_m} m");
}

/// Replayed, and learnt look by look, as if the robots had always driven on one map.
#[test]
fn a_place_of_both_maps_has_learnt_from_both() {
    let (target, source) = (first(unique), second(unique));
    let plan = plan(&source, &target);
    let joined = target.joined_by(&source, &plan);
    let mut replayed = Mapper::new(&model(), MapperSettings::default()).unwrap();
    joined.log.iter().for_each(|event| replayed.fold(event).unwrap());
    assert_eq!(replayed.state_hash(), joined.mapper.state_hash());

    for (place, appearance) in joined.mapper.recognizer().index().appearances().enumerate() {
        let mut learnt = Appearance::default();
        let frames = &joined.mapper.map().places()[place].frames;
        frames.iter().for_each(|frame| learnt.observe(&joined.event(frame.frame).observation));
        assert_eq!(appearance, learnt, "place {place}");
    }
    let of_both = |place: PlaceId| {
        let frames = &joined.mapper.map().places()[place.index()].frames;
        [0, 1].iter().all(|session| frames.iter().any(|frame| frame.session == *session))
    };
    assert!(plan.fused.iter().all(|fused| of_both(fused.matched.target)));
    let closures = joined.log[target.log.len()..].iter().filter(|event| match event {
        MapEvent::Frame(event) => {
            event.decision.reason == Reason::LoopClosure && event.verified_by().is_some()
        }
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => false,
    });
    assert!(closures.count() >= plan.fused.len(), "every fused place has its match in the log");
    // No two links between the same places.
    let mut ends: Vec<_> = joined
        .mapper
        .map()
        .links()
        .iter()
        .map(|link| (link.from.min(link.to), link.from.max(link.to)))
        .collect();
    let count = ends.len();
    ends.sort_unstable();
    ends.dedup();
    assert_eq!(ends.len(), count);
}

/// So that it can go on there.
#[test]
fn a_robot_that_joined_knows_where_it_is_on_the_target() {
    let (target, source) = (first(unique), second(unique));
    let joined = target.joined_by(&source, &plan(&source, &target));
    let session = joined.mapper.map().session(1).unwrap();
    let pose = joined.mapper.map_pose(session).unwrap();
    let truth = target.truth[1].inverse().compose(source.truth.last().unwrap());
    assert!(apart_m(&pose.robot, &truth) < 1.0, "{pose:?}, not {truth:?}");
}

#[test]
fn a_map_lies_over_itself() {
    let map = first(unique);
    let plan = plan(&map, &map);
    let transformation = plan.transformation;
    assert!(transformation.x_m().hypot(transformation.y_m()) < 0.1, "{transformation:?}");
    assert_eq!(plan.fused.len(), map.mapper.map().places().len());
    assert_eq!(plan.overlap.confirmed, plan.overlap.places);
    let joined = map.joined_by(&map, &plan);
    assert_eq!(joined.mapper.map().places().len(), map.mapper.map().places().len());
}

#[test]
fn other_buildings_stay_apart() {
    let (target, source) = (first(unique), second(elsewhere));
    assert_eq!(judged(&source, &target, &matches(&source, &target)), Verdict::Apart(Apart::NoMatches));
}

/// The corridor's second half looks as its first: a robot that has been in one of them only may
/// have been in either.
#[test]
fn halls_that_look_the_same_are_none_to_merge_by() {
    let along = |from_m: f64, steps: usize| {
        let mut robot = Robot::new(repeated, PlanarPose::new(from_m, 0.0, 0.0), [0.01, 0.003]);
        // A new place each, however alike: nothing is taken for known while the map is made.
        robot.looks = unique;
        ahead(&mut robot, steps);
        robot.looks = repeated;
        robot
    };
    let (target, source) = (along(0.1, 32), along(10.1, 14));
    let mut found = Vec::new();
    for place in PlaceId::first(source.mapper.map().places().len()) {
        let at = source.made_at(place);
        for other in PlaceId::first(target.mapper.map().places().len()) {
            let is_at = target.made_at(other);
            let view = seen(repeated, &is_at, &at);
            if view.motion.is_some() {
                let measured = PlanarPose::identity();
                let covariance = nalgebra::Matrix3::from_diagonal(&[0.06, 0.06, 0.003].into());
                found.push(PlaceMatch {
                    source: place,
                    target: other,
                    source_frame: 1 + u64::from(place),
                    target_frame: 1 + u64::from(other),
                    posterior: 0.9,
                    view: Some(view),
                    measured: RelativePose::new(measured, covariance).ok(),
                });
            }
        }
    }
    let verdict = judged(&source, &target, &found);
    assert!(matches!(verdict, Verdict::Apart(Apart::Ambiguous { .. })), "{verdict:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// The same where nobody knows metres.
    #[test]
    fn wrong_matches_change_nothing_without_metres(seed in any::<u64>()) {
        let target = without_metres(along(30), unique, PlanarPose::new(0.1, 0.0, 0.0));
        let source = without_metres(along(30), unique, PlanarPose::new(9.1, 0.0, 0.0));
        let true_ones = matches(&source, &target);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut all = true_ones.clone();
        for like in true_ones.iter().take(true_ones.len() / 4) {
            let [a, b] = [&source, &target].map(|robot| robot.mapper.map().places().len());
            all.push(PlaceMatch { source: PlaceId::from_index(random.random_range(0..a)), target: PlaceId::from_index(random.random_range(0..b)), ..*like });
        }
        let Verdict::Overlap(plan) = judged(&source, &target, &all) else { return Err(TestCaseError::fail("apart")) };
        for fused in &plan.fused {
            let [a, b] = [source.made_at(fused.matched.source), target.made_at(fused.matched.target)];
            prop_assert!(apart_m(&a, &b) < 2.0, "{fused:?}");
        }
        prop_assert!(plan.fused.len() >= 10);
        prop_assert_eq!(plan.matches.len() + plan.rejected.len(), all.len());
    }

    /// A fifth of the matches lead anywhere: none of them is believed, and the places that are
    /// fused are as right.
    #[test]
    fn wrong_matches_change_nothing(seed in any::<u64>()) {
        let (target, source) = (first(unique), second(unique));
        let true_ones = matches(&source, &target);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut all = true_ones.clone();
        for like in true_ones.iter().take(true_ones.len() / 4) {
            let [a, b] = [&source, &target].map(|robot| robot.mapper.map().places().len());
            all.push(PlaceMatch { source: PlaceId::from_index(random.random_range(0..a)), target: PlaceId::from_index(random.random_range(0..b)), ..*like });
        }
        let Verdict::Overlap(plan) = judged(&source, &target, &all) else { return Err(TestCaseError::fail("apart")) };
        for matched in &plan.matches {
            let [a, b] = [source.made_at(matched.source), target.made_at(matched.target)];
            prop_assert!(apart_m(&a, &b) < 1.5, "{matched:?}");
        }
        prop_assert!(plan.fused.len() >= 15);
        prop_assert_eq!(plan.matches.len() + plan.rejected.len(), all.len());
    }
}

#[test]
fn the_same_matches_on_any_number_of_threads() {
    let (target, source) = (first(unique), second(unique));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let found = matches(&source, &target);
            let verdict = judged(&source, &target, &found);
            (found, verdict)
        })
    };
    assert_eq!(on(1), on(4));
}

/// Ends the search after so many places.
struct Ends(usize);

impl MergeObserver for Ends {
    fn goes_on(&self, places: usize) -> bool {
        places < self.0
    }
}

#[test]
fn what_cannot_be_searched_says_why() {
    let (target, source) = (first(unique), second(unique));
    let search = |settings: &MergeSettings, observer: &dyn MergeObserver| {
        pairs_to_compare(source.known(), target.known(), settings, observer)
    };
    assert_eq!(search(&MergeSettings::default(), &Ends(3)), Err(MergeError::Ended));
    let none = MergeSettings { candidates: 0, ..MergeSettings::default() };
    assert_eq!(search(&none, &()), Err(MergeError::Setting { setting: "number of candidates", value: 0.0 }));
    let nan = MergeSettings { max_rival_share: f64::NAN, ..MergeSettings::default() };
    assert!(matches!(search(&nan, &()), Err(MergeError::Setting { .. })));
    let mut other = source.clone();
    other.mapper = Mapper::new(&model_of(900), MapperSettings::default()).unwrap();
    let found = pairs_to_compare(other.known(), target.known(), &MergeSettings::default(), &());
    assert_eq!(
        found.unwrap_err(),
        MergeError::Vocabulary { source_words: 900, target_words: WORDS as usize }
    );
    let empty = Robot::new(unique, PlanarPose::identity(), [0.0; 2]);
    assert_eq!(matches(&empty, &target), []);
    assert_eq!(judged(&empty, &target, &[]), Verdict::Apart(Apart::NothingMeasured));
    assert_eq!(judged(&source, &empty, &[]), Verdict::Apart(Apart::NothingToGoInto));
    assert_eq!(judged(&source, &target, &[]), Verdict::Apart(Apart::NoMatches));
}

#[test]
fn a_log_of_another_map_is_refused() {
    let (target, source) = (first(unique), second(unique));
    let plan = plan(&source, &target);
    // Without the frame that made the first place.
    let cut: Vec<MapEvent> = [&source.log[..1], &source.log[2..]].concat();
    assert!(join((&source.mapper, &target.mapper), &plan, &cut).is_err());
}
