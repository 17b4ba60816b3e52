//! A log without some of its sessions is the log as it would be if they had not been.

use std::collections::{BTreeMap, BTreeSet};

use crate::building::{Robot, WORDS, ahead, apart_m, first, model, plan, second, turn_left, unique};
use fabmap::appearance::{Appearance, PlaceId};
use posegraph::{PlanarPose, Pose};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::ids::SessionId;
use topomap::log::{FrameEvent, LinkKind, MapEvent, Reason};
use topomap::mapper::{Mapper, Measurement};
use topomap::metric::RelativePose;
use topomap::rewriting::{Dropped, RetellError, Retold, without_places, without_sessions};
use topomap::settings::MapperSettings;

pub(crate) fn without(log: &[MapEvent], sessions: &[SessionId]) -> Retold {
    without_sessions(&MapperSettings::default(), log, &sessions.iter().copied().collect()).unwrap()
}

/// The map that a log makes, through its byte form.
pub(crate) fn folded(log: &[MapEvent]) -> Mapper {
    let mut mapper = Mapper::new(&model(), MapperSettings::default()).unwrap();
    for event in log {
        let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(&stored, event);
        mapper.fold(&stored).unwrap();
    }
    mapper.relax();
    mapper
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Wheels {
    Read,
    Unread,
}

/// Robots that take turns in one corridor and its side corridors, and measure now and then.
pub(crate) fn take_turns(wheels: Wheels, sessions: SessionId, seed: u64) -> Robot {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let bias =
        |random: &mut ChaCha8Rng| [random.random_range(-0.01..0.01), random.random_range(-0.003..0.003)];
    let start =
        |random: &mut ChaCha8Rng| PlanarPose::new(0.6 * f64::from(random.random_range(0..6_u8)), 0.0, 0.0);
    let (pose, drift) = (start(&mut random), bias(&mut random));
    let mut robot = Robot::new(unique, pose, drift);
    let read = |robot: &mut Robot| {
        if wheels == Wheels::Unread {
            let session = robot.session;
            robot.runs.get_mut(&session).unwrap().odometry = None;
        }
    };
    read(&mut robot);
    for _ in 0..14 {
        let next = robot.mapper.map().next_session();
        if next < sessions && random.random_bool(0.4) {
            let (pose, drift) = (start(&mut random), bias(&mut random));
            robot.begin(pose, drift);
            read(&mut robot);
        } else {
            robot.session = random.random_range(0..next);
        }
        match random.random_range(0..6_u8) {
            0 => turn_left(&mut robot),
            1 => measure(&mut robot, &mut random),
            _ => ahead(&mut robot, random.random_range(2..7)),
        }
    }
    robot
}

/// The last frame of the session is measured from an earlier one, of any session.
fn measure(robot: &mut Robot, random: &mut ChaCha8Rng) {
    let frames = |event: &MapEvent| match event {
        MapEvent::Frame(event) => Some(event.as_ref().clone()),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    };
    let all: Vec<FrameEvent> = robot.log.iter().filter_map(frames).collect();
    let of_session: Vec<&FrameEvent> = all.iter().filter(|event| event.session == robot.session).collect();
    let Some((later, before)) = of_session.split_last() else { return };
    let earlier = &all[random.random_range(0..all.len())];
    let [from, to] = [earlier.frame, later.frame].map(|frame| robot.truth[frame as usize]);
    let pose = RelativePose::new(from.inverse().compose(&to), nalgebra::Matrix3::identity() * 1e-4).unwrap();
    let before = before.last().copied();
    if let Ok(event) = robot.mapper.measure(&Measurement { later, before, earlier, pose }) {
        robot.take(MapEvent::Measured(Box::new(event)), to);
    }
}

pub(crate) fn frames(log: &[MapEvent]) -> impl Iterator<Item = &FrameEvent> {
    log.iter().filter_map(|event| match event {
        MapEvent::Frame(event) => Some(event.as_ref()),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    })
}

/// What a place has learnt is what its frames showed.
fn check_appearances(log: &[MapEvent], map: &Mapper) {
    let mut learnt: BTreeMap<PlaceId, Appearance> = BTreeMap::new();
    for event in frames(log).filter(|event| event.learnt) {
        learnt.entry(event.decision.place.unwrap()).or_default().observe(&event.observation);
    }
    let appearances: Vec<Appearance> = map.recognizer().index().appearances().collect();
    assert_eq!(appearances, learnt.into_values().collect::<Vec<_>>());
}

/// Beliefs are of places that there are, and sum to 1; matches are with frames of their places.
pub(crate) fn check_names(log: &[MapEvent], map: &Mapper) {
    let mut made = 0;
    for event in frames(log) {
        made += u32::from(event.decision.place == Some(PlaceId::new(made)));
        let belief = &event.belief;
        assert!(
            belief.places.is_sorted_by(|a, b| a.0 < b.0)
                && belief.places.iter().all(|(place, _)| *place < PlaceId::new(made))
        );
        let sum =
            belief.places.iter().map(|place| place.1).sum::<f64>() + belief.new_place + belief.remainder;
        assert!((sum - 1.0).abs() < 1e-9, "{belief:?}");
        assert!(
            (0.0..=1.0).contains(&event.decision.posterior)
                && (0.0..=1.0).contains(&event.new_place_posterior)
        );
        let matches = event.candidates.iter().map(|candidate| candidate.matched);
        for matched in matches.chain(event.proposal).chain(event.decision.closure) {
            assert!(matched.frame < event.frame && map.map().locate(matched.place, matched.frame).is_some());
        }
        match event.decision.reason {
            Reason::LoopClosure => {
                assert_eq!(event.decision.closure.map(|closure| closure.place), event.decision.place);
            }
            Reason::NewPlace => assert_eq!(event.decision.closure, None),
            Reason::SamePlace | Reason::BelowThreshold | Reason::TooFewWords | Reason::GeometryRefused => {}
        }
    }
}

/// From each place where a session was links lead to the next, and no two places have two that
/// frames added.
fn check_links(log: &[MapEvent], map: &Mapper) {
    let mut last: BTreeMap<SessionId, PlaceId> = BTreeMap::new();
    let mut linked: BTreeSet<[PlaceId; 2]> = BTreeSet::new();
    for event in frames(log) {
        if let Some(link) = &event.link {
            assert!(linked.insert([link.from.min(link.to), link.from.max(link.to)]), "{link:?}");
        }
        let Some(place) = event.decision.place else { continue };
        let Some(before) = last.insert(event.session, place) else { continue };
        assert_eq!(map.poses().part(place), map.poses().part(before), "{before} and {place} are apart");
    }
}

/// How far places lie from where their first frames truly were, once the first places of their
/// parts lie there.
fn errors_m(log: &[MapEvent], map: &Mapper, truth: impl Fn(u64) -> PlanarPose) -> Vec<f64> {
    let mut made: Vec<PlanarPose> = Vec::new();
    for event in frames(log) {
        if event.decision.place == Some(PlaceId::from_index(made.len())) {
            made.push(truth(event.frame));
        }
    }
    let error_m = |(place, truth): (PlaceId, &PlanarPose)| {
        let part = map.poses().part(place).unwrap();
        let origin = made[part.index()];
        apart_m(&origin.inverse().compose(truth), map.poses().pose(place).unwrap())
    };
    PlaceId::all().zip(&made).map(error_m).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn without_any_session_the_log_is_as_it_was(seed in any::<u64>()) {
        let robot = take_turns(Wheels::Read, 3, seed);
        let retold = without(&robot.log, &[]);
        prop_assert_eq!(&retold.events, &robot.log);
        prop_assert_eq!(retold.dropped, Dropped::default());
        let places = robot.mapper.map().places().len();
        prop_assert_eq!(retold.places, PlaceId::first(places).map(Some).collect::<Vec<_>>());
    }

    #[test]
    fn without_the_session_that_came_last_the_log_is_that_before_it(seed in any::<u64>()) {
        let mut robot = take_turns(Wheels::Read, 2, seed);
        let (before, places) = (robot.log.clone(), robot.mapper.map().places().len());
        robot.begin(PlanarPose::new(0.3, 0.0, 0.0), [0.01, 0.003]);
        ahead(&mut robot, 12);
        turn_left(&mut robot);
        ahead(&mut robot, 4);
        let retold = without(&robot.log, &[robot.session]);
        prop_assert_eq!(&retold.events, &before);
        prop_assert!(retold.places.iter().enumerate().all(|(place, kept)| kept.is_some() == (place < places)));
        prop_assert_eq!(retold.frames, (0..before.len() as u64).map(|frame| (frame, frame)).collect::<BTreeMap<_, _>>());
    }

    /// Whatever sessions are left out of whatever log.
    #[test]
    fn what_is_told_is_a_map(seed in any::<u64>(), removed in proptest::collection::btree_set(0..4u32, 1..3)) {
        let robot = take_turns(Wheels::Read, 4, seed);
        let sessions = robot.mapper.map().next_session();
        let removed: Vec<SessionId> = removed.into_iter().filter(|&session| session < sessions).collect();
        let retold = without(&robot.log, &removed);
        let map = folded(&retold.events);
        check_appearances(&retold.events, &map);
        check_names(&retold.events, &map);
        check_links(&retold.events, &map);

        let first = robot.log.iter().position(|event| removed.contains(&event.session())).unwrap_or(robot.log.len());
        prop_assert_eq!(&retold.events[..first], &robot.log[..first]);
        check_stays(&robot.log, &retold, &removed);

        // Wheels of 1 % and 0.2 degrees a metre, and closures of a quarter of a metre.
        let positions: BTreeMap<u64, u64> = retold.frames.iter().map(|(&was, &is)| (is, was)).collect();
        let errors_m = errors_m(&retold.events, &map, |frame| robot.truth[positions[&frame] as usize]);
        prop_assert!(errors_m.iter().all(|error_m| *error_m < 1.5), "{errors_m:?}");
    }

    /// Without odometry places are linked, and that is all.
    #[test]
    fn maps_without_metres_are_told_as_well(seed in any::<u64>(), removed in 0..3u32) {
        let robot = take_turns(Wheels::Unread, 3, seed);
        let removed: Vec<SessionId> = Some(removed).into_iter().filter(|&session| session < robot.mapper.map().next_session()).collect();
        let retold = without(&robot.log, &removed);
        let map = folded(&retold.events);
        check_appearances(&retold.events, &map);
        check_names(&retold.events, &map);
        check_stays(&robot.log, &retold, &removed);
        let mut last: BTreeMap<SessionId, PlaceId> = BTreeMap::new();
        for event in frames(&retold.events) {
            let Some(place) = event.decision.place else { continue };
            let Some(before) = last.insert(event.session, place) else { continue };
            prop_assert!(before == place || map.map().linked(before).contains(&place), "{} to {}", before, place);
        }
    }

    /// Frames at places that are dropped stay, at none; the others hang together as before.
    #[test]
    fn without_some_places_all_frames_stay(seed in any::<u64>(), dropped in proptest::collection::vec(any::<prop::sample::Index>(), 1..8)) {
        let robot = take_turns(Wheels::Read, 3, seed);
        let places = robot.mapper.map().places().len();
        if places == 0 {
            return Ok(());
        }
        let dropped: BTreeSet<PlaceId> = dropped.into_iter().map(|index| PlaceId::from_index(index.index(places))).collect();
        let retold = without_places(&MapperSettings::default(), &robot.log, &dropped).unwrap();
        let map = folded(&retold.events);
        check_appearances(&retold.events, &map);
        check_names(&retold.events, &map);
        check_links(&retold.events, &map);
        prop_assert_eq!(map.map().places().len(), places - dropped.len());
        prop_assert_eq!(retold.dropped.places, dropped.len() as u64);
        let observed = |log: &[MapEvent]| frames(log).map(|event| (event.session, event.observation.clone())).collect::<Vec<_>>();
        prop_assert_eq!(observed(&retold.events), observed(&robot.log));
        let positions: BTreeMap<u64, u64> = retold.frames.iter().map(|(&was, &is)| (is, was)).collect();
        let errors_m = errors_m(&retold.events, &map, |frame| robot.truth[positions[&frame] as usize]);
        prop_assert!(errors_m.iter().all(|error_m| *error_m < 1.5), "{errors_m:?}");
    }
}

/// All frames of the sessions that stay are there, at what their places have become.
fn check_stays(log: &[MapEvent], retold: &Retold, removed: &[SessionId]) {
    let told: BTreeMap<u64, &FrameEvent> = frames(&retold.events).map(|event| (event.frame, event)).collect();
    let mut visited: BTreeSet<PlaceId> = BTreeSet::new();
    for event in frames(log) {
        let position = retold.frames.get(&event.frame);
        assert_eq!(position.is_some(), !removed.contains(&event.session));
        let Some(told) = position.map(|position| told[position]) else { continue };
        assert_eq!((&told.observation, &told.odometry), (&event.observation, &event.odometry));
        assert_eq!(told.session, retold.sessions[&event.session]);
        let place = event.decision.place.and_then(|place| retold.places[place.index()]);
        assert_eq!(told.decision.place, place);
        visited.extend(event.decision.place);
    }
    let kept = PlaceId::all().zip(&retold.places).filter(|(_, kept)| kept.is_some()).map(|(place, _)| place);
    assert_eq!(kept.collect::<BTreeSet<PlaceId>>(), visited);
    assert_eq!(retold.dropped.events + retold.events.len() as u64, log.len() as u64);
}

#[test]
fn a_merge_is_undone_as_if_it_had_not_been() {
    let (target, source) = (first(unique), second(unique));
    let joined = target.joined_by(&source, &plan(&source, &target));
    let retold = without(&joined.log, &[1]);
    assert_eq!(retold.events, target.log);
    assert_eq!(folded(&retold.events).state_hash(), target.mapper.state_hash());
}

/// Where it went it still is: the target's places are as they were, and those that only the source
/// had seen are its own.
#[test]
fn a_session_that_came_after_a_merge_stays_when_it_is_undone() {
    let (target, source) = (first(unique), second(unique));
    let mut joined = target.joined_by(&source, &plan(&source, &target));
    // From the target's part of the corridor through what both have seen to what only the source
    // has.
    joined.begin(PlanarPose::new(6.1, 0.0, 0.0), [0.005, -0.002]);
    ahead(&mut joined, 20);
    turn_left(&mut joined);
    ahead(&mut joined, 24);
    let shared =
        frames(&joined.log).filter(|event| event.session == 2).filter_map(|event| event.decision.place);
    let only_source = |place: &PlaceId| joined.mapper.map().places()[place.index()].frames[0].session == 1;
    assert!(shared.filter(only_source).count() >= 5, "it has been where only the source was");

    let retold = without(&joined.log, &[1]);
    assert_eq!(retold.events[..target.log.len()], target.log);
    assert_eq!(retold.sessions, BTreeMap::from([(0, 0), (2, 1)]));
    assert!(retold.dropped.closures >= 5, "{:?}", retold.dropped);
    let map = folded(&retold.events);
    check_names(&retold.events, &map);
    check_links(&retold.events, &map);
    check_appearances(&retold.events, &map);
    // Of each frame, where it was on the map before and is now.
    for event in frames(&joined.log).filter(|event| event.session == 2) {
        let MapEvent::Frame(told) = &retold.events[retold.frames[&event.frame] as usize] else {
            panic!("{event:?}")
        };
        let [was, is] = [(event, &joined.mapper), (told.as_ref(), &map)].map(|(event, mapper)| {
            let place = event.decision.place.unwrap();
            assert_eq!(mapper.poses().part(place), Some(PlaceId::new(0)));
            mapper.poses().pose(place).unwrap().compose(event.at.unwrap().pose())
        });
        assert!(apart_m(&was, &is) < 0.6, "{was:?}, now {is:?}");
    }
}

/// The second robot drove where the first had, and made no link of its own: without the first, its
/// wheels measure them.
#[test]
fn ways_that_a_removed_session_had_linked_are_as_the_other_drove_them() {
    let mut robot = Robot::new(unique, PlanarPose::new(0.1, 0.0, 0.0), [0.0; 2]);
    ahead(&mut robot, 12);
    robot.begin(PlanarPose::new(0.1, 0.0, 0.0), [0.01, 0.0]);
    ahead(&mut robot, 12);
    let own_links = |log: &[MapEvent], session| {
        frames(log).filter(|event| event.session == session).filter_map(|event| event.link).count()
    };
    let places = robot.mapper.map().places().len();
    assert!(own_links(&robot.log, 1) < places / 2, "its way was known");
    let retold = without(&robot.log, &[0]);
    let visited: BTreeSet<PlaceId> = frames(&robot.log)
        .filter(|event| event.session == 1)
        .filter_map(|event| event.decision.place)
        .collect();
    assert_eq!(own_links(&retold.events, 0), visited.len() - 1);
    for event in frames(&retold.events) {
        let Some(link) = event.link else { continue };
        let LinkKind::Driven(driven) = link.kind else { panic!("{link:?}") };
        let steps = (driven.pose().x_m() / (0.6 * 1.01)).round();
        assert!(
            (driven.pose().x_m() - steps * 0.6 * 1.01).abs() < 1e-9 && driven.pose().y_m().abs() < 1e-9,
            "{link:?}"
        );
    }
    // As a robot that drives on its own.
    assert!(
        frames(&retold.events)
            .all(|event| matches!(event.decision.reason, Reason::NewPlace | Reason::SamePlace))
    );
}

#[test]
fn what_cannot_be_told_says_why() {
    let robot = first(unique);
    let settings = MapperSettings::default();
    let refused = |log: &[MapEvent]| without_sessions(&settings, log, &BTreeSet::new()).unwrap_err();
    assert_eq!(
        without_sessions(&settings, &robot.log, &[1].into()),
        Err(RetellError::NoSession { session: 1 })
    );
    assert_eq!(
        without_places(&settings, &robot.log, &[PlaceId::new(999)].into()),
        Err(RetellError::NoPlace { place: PlaceId::new(999) })
    );
    assert_eq!(refused(&robot.log[1..]), RetellError::Position { expected: 0, found: 1 });
    assert_eq!(
        refused(&[&robot.log[..4], &robot.log[5..]].concat()),
        RetellError::Position { expected: 4, found: 5 }
    );
    let mut other = robot.log.clone();
    other[0] = MapEvent::SessionOpened { session: 3 };
    assert_eq!(refused(&other), RetellError::Unknown { position: 0 });
    let MapEvent::Frame(event) = &robot.log[5] else { panic!("no frame") };
    let elsewhere = topomap::log::Decision { place: Some(PlaceId::new(99)), ..event.decision };
    other = robot.log.clone();
    other[5] = MapEvent::Frame(Box::new(FrameEvent { decision: elsewhere, ..event.as_ref().clone() }));
    assert_eq!(refused(&other), RetellError::Unknown { position: 5 });
}
