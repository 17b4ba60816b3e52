//! What geometry says decides: closures, what is remembered of them, and what the log keeps.

use crate::words::WORDS;
use fabmap::PlaceId;
use fabmap::codec::{Reader, Writer};
use nalgebra::{Matrix3, UnitQuaternion, UnitVector3, Vector3};
use posegraph::PlanarPose;
use proptest::prelude::*;
use topomap::checkpoint::{Changes, Pieces, Restoration};
use topomap::evidence::{
    Candidate, Contributions, Match, Placement, ProbabilityWeights, Quantity, Similarity, TwoView,
    VerificationMethod, VerificationSettings, ViewMotion,
};
use topomap::ids::FrameId;
use topomap::in_memory::{self, NoViews, Views};
use topomap::log::{MapEvent, Reason};
use topomap::map::decode_place;
use topomap::mapper::{FrameInput, Localizer, Mapper};
use topomap::metric::RelativePose;
use topomap::settings::MapperSettings;

use crate::look_alikes::{FrameEventViews, Truth, World, model, plane, settings, view};

#[test]
fn geometry_confirms_what_words_are_sure_of() {
    let mut world = World::new(settings());
    for place in 1..=6 {
        assert_eq!(world.sees(place, 40).decision.reason, Reason::NewPlace);
    }
    let event = world.sees(1, 40);
    assert_eq!((event.decision.reason, event.decision.place), (Reason::LoopClosure, Some(PlaceId::new(0))));
    assert!(event.candidates.len() <= VerificationSettings::MAX_CANDIDATES);
    let candidate =
        event.candidates.iter().find(|candidate| candidate.matched.place == PlaceId::new(0)).unwrap();
    assert_eq!((Some(candidate.matched), candidate.view.unwrap().inliers), (event.decision.closure, 40));
    assert!(world.mapper.verdict(candidate).is_accepted());
    // Of the words it is sure: the evidence of one frame is not enough by itself.
    let weights = ProbabilityWeights::default();
    let Contributions { offset_nats, geometry_nats, words_nats } = candidate.contributions(&weights);
    let by_geometry = 1.0 / (1.0 + (-offset_nats - geometry_nats).exp());
    assert!(by_geometry < settings().closure_threshold && words_nats > 0.0, "{by_geometry}");
    assert_eq!(candidate.log_odds_nats, offset_nats + geometry_nats + words_nats);
}

#[test]
fn look_alikes_are_refused_and_make_a_place() {
    let mut world = World::new(settings());
    for place in 1..=6 {
        world.sees(place, 40);
    }
    let elsewhere = |_: &[u64]| FrameEventViews { inliers: 40, shift_widths: 0.1, truly: Some(99) };
    let event = world.see(1, elsewhere);
    assert_eq!(
        (event.decision.reason, event.decision.place),
        (Reason::GeometryRefused, Some(PlaceId::new(6)))
    );
    assert_eq!(event.decision.closure.map(|closure| closure.place), Some(PlaceId::new(0)));
    let refused =
        event.candidates.iter().find(|candidate| candidate.matched.place == PlaceId::new(0)).unwrap();
    let failed = *world.mapper.verdict(refused).failed().unwrap();
    assert_eq!((failed.quantity, failed.value), (Quantity::Inliers, 3.0));
}

#[test]
fn a_view_from_too_far_aside_is_refused() {
    let mut world = World::new(settings());
    for place in 1..=6 {
        world.sees(place, 40);
    }
    let aside = |_: &[u64]| FrameEventViews { inliers: 40, shift_widths: 0.7, truly: None };
    let event = world.see(1, aside);
    assert_eq!(event.decision.reason, Reason::GeometryRefused);
    let failed = *world.mapper.verdict(&event.candidates[0]).failed().unwrap();
    assert_eq!((failed.quantity, failed.value), (Quantity::TranslationWidths, 0.7));
}

#[test]
fn without_keypoints_words_decide_alone() {
    let mut world = World::new(settings());
    for place in 1..=6 {
        world.sees(place, 40);
    }
    let event = world.decide(1, &NoViews);
    assert_eq!((event.decision.reason, event.decision.place), (Reason::LoopClosure, Some(PlaceId::new(0))));
    let closed =
        event.candidates.iter().find(|candidate| candidate.matched.place == PlaceId::new(0)).unwrap();
    assert!(closed.view.is_none() && world.mapper.verdict(closed).is_accepted());
    let other = event.candidates.iter().find(|candidate| candidate.matched.place != PlaceId::new(0)).unwrap();
    let failed = *world.mapper.verdict(other).failed().unwrap();
    assert_eq!(failed.quantity, Quantity::Posterior);
    // A robot that stands still stays where it is all the same.
    assert_eq!(world.decide(6, &NoViews).decision.reason, Reason::SamePlace);
}

#[test]
fn the_place_where_the_session_is_must_look_the_same() {
    let mut world = World::new(settings());
    for place in 1..=3 {
        world.sees(place, 40);
    }
    assert_eq!(
        world
            .decide(3, &Truth { shows: &world.shows, current: 3, inliers: 40, shift_widths: 0.0 })
            .decision
            .reason,
        Reason::SamePlace
    );
    let moved_on =
        world.decide(3, &Truth { shows: &world.shows, current: 98, inliers: 40, shift_widths: 0.0 });
    assert_ne!(moved_on.decision.place, Some(PlaceId::new(2)));
}

proptest! {
    /// Written out: ln [p / (1 - p)] = a + b evidence / look-alikes + c ln [posterior / (1 - posterior)],
    /// the last at least -20.
    #[test]
    fn words_and_geometry_make_one_probability(
        inliers in 0..500u32, support in 0.0..2000.0f64, log_odds in -200.0..200.0f64,
        look_alikes in 1.0..300.0f64, a in -4.0..0.0f64, b in 0.1..3.0f64, c in 0.0..0.3f64,
    ) {
        let matched = Match { place: PlaceId::new(3), posterior: 1.0 / (1.0 + (-log_odds).exp()), log_odds, frame: 9 };
        let weights = ProbabilityWeights { offset_nats: a, per_look_alike_nats: b, per_word_nat: c };
        let of = |inliers| {
            let view = plane(500, inliers, [0.1, 0.0]);
            Candidate::new(matched, Some(view), None, look_alikes).judged(support, &weights)
        };
        let seen = of(inliers);
        let log_odds = a + b * seen.evidence() / look_alikes + c * f64::max(log_odds, -20.0);
        let probability = seen.probability();
        prop_assert!((probability - 1.0 / (1.0 + (-log_odds).exp())).abs() < 1e-9, "{probability}");
        let likelier = of(inliers + 10);
        prop_assert!((0.0..=1.0).contains(&probability) && likelier.probability() >= probability);
        let unseen = Candidate::new(matched, None, None, look_alikes).judged(support, &weights);
        prop_assert_eq!(unseen.probability(), matched.posterior);
    }
}

/// A second round: each frame's match stands beside those of the frames before, and adds to their
/// evidence.
#[test]
fn matches_in_line_support_each_other() {
    let mut world = World::new(settings());
    for place in 1..=12 {
        world.sees(place, 40);
    }
    let mut evidence = Vec::new();
    for place in 1..=8 {
        let event = world.sees(place, 23);
        let proposed =
            event.candidates.iter().find(|candidate| Some(candidate.matched) == event.proposal).unwrap();
        assert_eq!(proposed.matched.place, PlaceId::new(place as u32 - 1));
        evidence.push(proposed.evidence());
    }
    // 20 each beyond chance: 20 (k + 1) after k frames in line.
    for (earlier, evidence) in evidence.iter().enumerate() {
        let expected = 20.0 * (earlier as f64 + 1.0);
        assert!((evidence - expected).abs() < 1e-9, "{earlier}: {evidence}, not {expected}");
    }
    // Support is worth nothing where the frame itself has no match.
    let elsewhere = |_: &[u64]| FrameEventViews { inliers: 23, shift_widths: 0.1, truly: Some(99) };
    let event = world.see(9, elsewhere);
    assert!(event.candidates.iter().all(|candidate| candidate.evidence() == 0.0));
    assert!(event.candidates.iter().any(|candidate| candidate.support > 0.0));
    assert_ne!(event.decision.reason, Reason::LoopClosure);
}

#[test]
fn without_memory_each_frame_stands_alone() {
    let verification = VerificationSettings { consistency_frames: 0, ..VerificationSettings::default() };
    let mut world = World::new(MapperSettings { verification, ..settings() });
    for place in (1..=12).chain(1..=8) {
        let event = world.sees(place, 23);
        assert!(event.candidates.iter().all(|candidate| candidate.support == 0.0));
    }
}

#[test]
fn geometry_closes_where_words_cannot() {
    // As if look-alikes were known to show nothing.
    let weights = ProbabilityWeights { per_look_alike_nats: 20.0, ..ProbabilityWeights::default() };
    let verification = VerificationSettings { weights, ..VerificationSettings::default() };
    let mut world = World::new(MapperSettings { verification, ..settings() });
    for place in 1..=6 {
        world.sees(place, 60);
    }
    // Words of a place never seen, in the scene of the second.
    let dimmed = |_: &[u64]| FrameEventViews { inliers: 60, shift_widths: 0.1, truly: Some(2) };
    let event = world.see(50, dimmed);
    assert_eq!((event.decision.reason, event.decision.place), (Reason::LoopClosure, Some(PlaceId::new(1))));
    assert!(event.decision.posterior < 0.5);
}

#[test]
fn nothing_is_compared_where_nothing_is_verified() {
    struct Unwanted;
    impl Views for Unwanted {
        fn compare(&self, earlier: FrameId) -> Option<TwoView> {
            panic!("frame {earlier} was compared")
        }

        fn focal_length_widths(&self) -> Option<f64> {
            None
        }
    }
    let mut world = World::new(MapperSettings { verification: VerificationSettings::none(), ..settings() });
    for place in [1, 2, 3, 4, 5, 6, 1, 1] {
        let event = world.decide(place, &Unwanted);
        assert_eq!(event.candidates, []);
        let stored = MapEvent::Frame(Box::new(event));
        world.mapper.apply(&stored).unwrap();
        world.log.push(stored);
    }
    let MapEvent::Frame(closing) = &world.log[7] else { panic!("{:?}", world.log[7]) };
    assert_eq!(closing.decision.reason, Reason::LoopClosure);
}

#[test]
fn a_query_is_verified_too() {
    let mut world = World::new(settings());
    for place in 1..=6 {
        world.sees(place, 40);
    }
    let ask = |truly, inliers| {
        let truth = Truth { shows: &world.shows, current: truly, inliers, shift_widths: 0.1 };
        in_memory::query(&world.mapper, &world.log, &view(2, 777), &truth).unwrap()
    };
    let found = ask(2, 40);
    assert_eq!((found.accepted, found.matched.unwrap().place), (true, PlaceId::new(1)));
    assert!(!ask(99, 40).accepted);
}

fn placements() -> impl Strategy<Value = Placement> {
    let at = (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(0.0..1.0f64), 0..500u32);
    let at = at.prop_map(|([x, y, heading], variances, inliers)| {
        let covariance = Matrix3::from_diagonal(&variances.into());
        let pose = RelativePose::new(PlanarPose::new(x, y, heading), covariance).unwrap();
        Placement::At { pose, inliers }
    });
    prop_oneof![Just(Placement::Unknown), Just(Placement::Nowhere), at]
}

fn motions() -> impl Strategy<Value = Option<ViewMotion>> {
    let number = -3.0..3.0f64;
    let similarity =
        [number.clone(), number.clone(), number.clone(), number.clone()].prop_map(|[a, b, x, y]| {
            Some(ViewMotion::Similarity(Similarity {
                rotation_rad: a,
                ln_scale: b,
                translation_widths: [x, y],
            }))
        });
    let essential = [number.clone(), number.clone(), number.clone()].prop_map(|[a, b, c]| {
        let direction = UnitVector3::new_normalize(Vector3::new(a, b, 1.0 + c.abs()));
        Some(ViewMotion::Essential { rotation: UnitQuaternion::from_euler_angles(a, b, c), direction })
    });
    let fundamental =
        [number.clone(), number.clone(), number].prop_map(|row| Some(ViewMotion::Fundamental([row; 3])));
    prop_oneof![Just(None), similarity, essential, fundamental]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn live_replayed_and_restored_agree_and_never_compare_again(
        places in proptest::collection::vec((0..9u64, 0..60u32), 1..40), cut in any::<prop::sample::Index>(),
    ) {
        let mut world = World::new(settings());
        for &(place, inliers) in &places {
            world.sees(place, inliers);
        }
        let model = model();
        let mut replayed = Mapper::new(&model, settings()).unwrap();
        world.log.iter().for_each(|event| replayed.apply(event).unwrap());
        prop_assert_eq!(replayed.state_hash(), world.mapper.state_hash());
        prop_assert_eq!(replayed.map(), world.mapper.map());

        let checkpoint = cut.index(world.log.len() + 1);
        let mut half = Mapper::new(&model, settings()).unwrap();
        world.log[..checkpoint].iter().for_each(|event| half.apply(event).unwrap());
        let mut changes = Changes::default();
        world.log[..checkpoint].iter().for_each(|event| changes.follow(event));
        let Pieces { head, sessions, links, places, .. } = half.pieces(&changes);
        let mut restoration = Restoration::new(&model, settings(), &head).unwrap();
        sessions.iter().for_each(|(id, bytes)| restoration.session(*id, bytes).unwrap());
        links.iter().for_each(|(first, bytes)| restoration.links(*first, bytes).unwrap());
        places.iter().for_each(|(id, bytes)| restoration.place(*id, decode_place(bytes, WORDS as usize).unwrap()).unwrap());
        let mut restored = restoration.finish().unwrap();
        world.log[checkpoint..].iter().for_each(|event| restored.apply(event).unwrap());
        prop_assert_eq!(restored.state_hash(), world.mapper.state_hash());
        prop_assert_eq!(restored.map(), world.mapper.map());
    }

    /// A robot that only looks remembers its matches as a session of the log does.
    #[test]
    fn localizing_is_verified_as_mapping_is(seen in proptest::collection::vec(1..8u64, 1..10)) {
        let mut world = World::new(settings());
        for place in 1..=8 {
            world.sees(place, 40);
        }
        let mut localizer = Localizer::new();
        for (step, &place) in seen.iter().enumerate() {
            let input = FrameInput { session: Localizer::SESSION, sequence: step as u64 + 1, ..world.input(place) };
            let input = FrameInput { stamp_ns: step as i64 + 1, ..input };
            let truth = Truth { shows: &world.shows, current: place, inliers: 40, shift_widths: 0.1 };
            let event =
                in_memory::localize(&world.mapper, &localizer, &world.log, input, &truth).unwrap().event;
            let proposed = event.proposal.unwrap();
            prop_assert_eq!(u64::from(proposed.place), place - 1);
            localizer.follow(&event, &world.mapper);
        }
    }

    #[test]
    fn candidates_survive_their_bytes(
        motion in motions(), inliers in 0..500u32, more in 0..500u32, distinct in 0.0..=1.0f64, support in 0.0..1e4f64,
        seen in any::<bool>(), placement in placements(), cut in any::<prop::sample::Index>(),
    ) {
        let mut world = World::new(settings());
        world.sees(1, 40);
        let mut event = world.decide(2, &NoViews);
        let distinct_inliers = (f64::from(inliers) * distinct) as u32;
        let view = TwoView { matches: inliers + more, inliers, distinct_inliers, motion, placement };
        let matched = Match { place: PlaceId::new(0), posterior: 0.25, log_odds: -1.0, frame: 1 };
        let seen_from = seen.then(RelativePose::none);
        let candidate = Candidate::new(matched, seen.then_some(view), seen_from, 1.0 + support);
        event.candidates = vec![candidate.judged(support, &ProbabilityWeights::default())];
        let event = MapEvent::Frame(Box::new(event));
        let bytes = event.to_bytes();
        prop_assert_eq!(&MapEvent::from_bytes(&bytes, WORDS as usize).unwrap(), &event);
        prop_assert!(MapEvent::from_bytes(&bytes[..cut.index(bytes.len())], WORDS as usize).is_err());
        let MapEvent::Frame(frame) = event else { unreachable!() };
        let candidate = frame.candidates[0];
        prop_assert!(candidate.evidence() <= candidate.own_evidence() + 2.0 * f64::from(view.placement.inliers()) + candidate.support);
        prop_assert!(candidate.score().is_finite());
    }
}

/// Frames that version 2 logged: two rounds of six places, the second one verified.
const LOGGED_BY_VERSION_2: &[u8] = include_bytes!("fixtures/log-v2.bin");

#[test]
fn a_log_of_version_2_still_folds() {
    let mut reader = Reader::new(LOGGED_BY_VERSION_2);
    let mut mapper = Mapper::new(&model(), settings()).unwrap();
    let mut frames = Vec::new();
    while reader.remaining() > 0 {
        let event = MapEvent::from_bytes(reader.bytes().unwrap(), WORDS as usize).unwrap();
        mapper.apply(&event).unwrap();
        if let MapEvent::Frame(frame) = event {
            frames.push(frame);
        }
    }
    assert_eq!(frames.len(), 12);
    assert!(frames[6..].iter().all(|frame| frame.decision.reason == Reason::LoopClosure));
    assert!(frames[7..].iter().all(|frame| frame.candidates.iter().any(|candidate| candidate.support > 0.0)));
    assert_eq!(mapper.recognizer().places(), 6);
    assert!(!mapper.map().session(0).unwrap().sightings.is_empty());
}

#[test]
#[ignore = "writes the fixture of a new format version"]
fn write_fixture() {
    let mut world = World::new(settings());
    for place in (1..=6).chain(1..=6) {
        world.sees(place, 40);
    }
    let mut writer = Writer::default();
    world.log.iter().for_each(|event| writer.bytes(&event.to_bytes()));
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/log-v2.bin");
    std::fs::write(file, writer.into_bytes()).unwrap();
}

#[test]
fn methods_have_their_own_bounds() {
    let settings =
        VerificationSettings { method: VerificationMethod::Epipolar, ..VerificationSettings::default() };
    let motion = Some(ViewMotion::Essential {
        rotation: UnitQuaternion::from_euler_angles(0.0, 0.9, 0.0),
        direction: Vector3::x_axis(),
    });
    let placement = Placement::Unknown;
    let view = TwoView { matches: 90, inliers: 60, distinct_inliers: 50, motion, placement };
    let failed: Vec<Quantity> = settings
        .of_one_scene(&view)
        .iter()
        .filter(|check| !check.passed())
        .map(|check| check.quantity)
        .collect();
    assert_eq!(failed, [Quantity::RotationRad]);
    // 55 weighted inliers, less what chance brings together.
    assert_eq!(view.evidence(), 49.0);
    assert_eq!(TwoView { motion: None, ..view }.evidence(), 0.0);
}
