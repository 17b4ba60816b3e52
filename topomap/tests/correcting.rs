//! What people say of loop closures: a log with corrections folds to the same map however it is
//! folded, and one that is undone leaves nothing behind.

use fabmap::appearance::PlaceId;
use posegraph::{PlanarPose, Pose};
use proptest::prelude::*;
use topomap::checkpoint::{Changes, Restoration, decode_block};
use topomap::evidence::TwoView;
use topomap::ids::FrameId;
use topomap::log::{
    Confirmation, Correction, CorrectionEvent, FrameEvent, LinkKind, MapEvent, MeasuredEvent, Reason,
    Withdrawal,
};
use topomap::mapper::{CorrectError, FoldError, Heard, MeasureError, Measurement, Said, SamePlace};
use topomap::metric::RelativePose;
use topomap::settings::MapperSettings;

use crate::building::{
    FOCAL_LENGTH_WIDTHS, Robot, WORDS, again_after, ahead, apart_m, first, model, plan, second, seen,
    turn_left, unique,
};
use crate::rewriting::{Wheels, folded, frames, take_turns, without};

fn said() -> Said {
    Said { by: "anna".to_owned(), said_ns: 1_772_283_909_000_000_000 }
}

impl Robot {
    fn measured(&self, session: u32) -> Vec<MeasuredEvent> {
        let of_session = |event: &MapEvent| match event {
            MapEvent::Measured(event) if event.session == session => Some(event.as_ref().clone()),
            MapEvent::Measured(_)
            | MapEvent::SessionOpened { .. }
            | MapEvent::Frame(_)
            | MapEvent::Corrected(_) => None,
        };
        self.log.iter().filter_map(of_session).collect()
    }

    /// What follows from a closure being none; nothing is taken in.
    fn withdrawal(&self, closure: FrameId) -> Result<CorrectionEvent, CorrectError> {
        let closure = self.event(closure);
        let measured = self.measured(closure.session);
        let mut visit = self.mapper.visit(closure, &measured)?;
        let of_session: Vec<&FrameEvent> =
            frames(&self.log).filter(|event| event.session == closure.session).collect();
        let at = of_session.iter().position(|event| event.frame == closure.frame).unwrap();
        let _ = of_session[..at].iter().rev().all(|frame| visit.came_from(frame) == Heard::More);
        let _ = of_session[at + 1..].iter().all(|frame| visit.went_on(frame) == Heard::More);
        visit.withdraw(said())
    }

    fn correct(&mut self, event: CorrectionEvent) {
        let event = MapEvent::Corrected(Box::new(event));
        let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(stored, event);
        self.take(stored, PlanarPose::identity());
    }

    fn withdraw(&mut self, closure: FrameId) -> Result<Withdrawal, CorrectError> {
        let event = self.withdrawal(closure)?;
        let Correction::Withdrawn(withdrawal) = event.correction.clone() else { panic!("{event:?}") };
        self.correct(event);
        Ok(*withdrawal)
    }

    fn confirmation(&self, later: FrameId, earlier: FrameId) -> Result<CorrectionEvent, CorrectError> {
        let view = seen(self.looks, &self.truth[earlier as usize], &self.truth[later as usize]);
        self.confirmation_by(later, earlier, Some(view))
    }

    fn confirmation_by(
        &self,
        later: FrameId,
        earlier: FrameId,
        view: Option<TwoView>,
    ) -> Result<CorrectionEvent, CorrectError> {
        let (later, earlier) = (self.event(later), self.event(earlier));
        let focal_length_widths = Some(FOCAL_LENGTH_WIDTHS);
        self.mapper.confirm(&SamePlace { later, earlier, view, focal_length_widths }, said())
    }

    fn undo(&mut self, correction: u64) -> Result<(), CorrectError> {
        let event = self.mapper.undo(correction, said())?;
        self.correct(event);
        Ok(())
    }

    fn closures(&self) -> Vec<FrameId> {
        let closes = |event: &&FrameEvent| event.decision.reason == Reason::LoopClosure;
        frames(&self.log).filter(closes).map(|event| event.frame).collect()
    }

    /// Places whose frames are not where the map puts them, by more than that.
    fn places_off(&self, more_than_m: f64) -> Vec<PlaceId> {
        let poses = self.mapper.poses();
        let map = self.mapper.map();
        let origin = |place: PlaceId| self.truth[map.places()[place.index()].frames[0].frame as usize];
        let off = |&place: &PlaceId| {
            let truth = origin(poses.part(place).unwrap()).inverse().compose(&origin(place));
            apart_m(&truth, poses.pose(place).unwrap()) > more_than_m
        };
        PlaceId::first(map.places().len()).filter(off).collect()
    }
}

/// A robot that takes the 46th metre for the first: so far on that drifting wheels could have led round to it.
fn deceived() -> (Robot, FrameId) {
    let mut robot = Robot::new(again_after::<45>, PlanarPose::new(0.0, 0.0, 0.0), [0.0; 2]);
    robot.see();
    ahead(&mut robot, 90);
    let closure = robot.closures()[0];
    (robot, closure)
}

/// Whatever the log's events are folded by.
fn check_folds(robot: &Robot) {
    let replayed = folded(&robot.log);
    assert_eq!(replayed.map(), robot.mapper.map());
    assert_eq!(replayed.state_hash(), robot.mapper.state_hash());
    let apart = |(a, b): (&PlanarPose, &PlanarPose)| apart_m(a, b);
    let poses = [&replayed, &robot.mapper].map(|mapper| mapper.poses().poses());
    let most_m = poses[0].iter().zip(poses[1]).map(apart).fold(0.0, f64::max);
    assert!(most_m < 1e-3, "poses of a replay are up to {most_m} m off");

    let mut changes = Changes::default();
    robot.log.iter().for_each(|event| changes.follow(event));
    let pieces = robot.mapper.pieces(&changes);
    let mut restoration = Restoration::new(&model(), MapperSettings::default(), &pieces.head).unwrap();
    pieces.sessions.iter().for_each(|(id, bytes)| restoration.session(*id, bytes).unwrap());
    pieces.links.iter().for_each(|(first, bytes)| restoration.links(*first, bytes).unwrap());
    for block in robot.mapper.blocks(1 << 20) {
        let (first, places) = decode_block(&block.bytes, WORDS as usize).unwrap();
        first.onwards().zip(places).for_each(|(id, place)| restoration.place(id, place).unwrap());
    }
    let restored = restoration.finish().unwrap();
    assert_eq!(restored.map(), robot.mapper.map());
    assert_eq!(restored.state_hash(), robot.mapper.state_hash());
}

#[test]
fn a_wrong_closure_is_taken_out_of_the_map() {
    let (mut robot, closure) = deceived();
    let hash = robot.mapper.state_hash();
    assert!(robot.mapper.poses().cost() > 0.0 || !robot.places_off(1.0).is_empty());
    let all = robot.closures();
    let corrections: Vec<Withdrawal> = all.iter().map(|&frame| robot.withdraw(frame).unwrap()).collect();
    assert_eq!(robot.places_off(0.2), [], "the map is as wheels say");
    let origin = robot.mapper.poses().part(PlaceId::new(0));
    let places = robot.mapper.map().places().len();
    assert!(
        PlaceId::first(places).all(|place| robot.mapper.poses().part(place) == origin),
        "it is one part still"
    );
    for frame in corrections.iter().flat_map(|withdrawal| &withdrawal.frames) {
        let place = robot.event(*frame).decision.place.unwrap();
        assert_eq!(robot.mapper.map().locate(place, *frame), None, "no frame is matched with it");
        assert!(robot.mapper.map().withdrawal_of(*frame).is_some());
    }
    check_folds(&robot);

    assert_eq!(
        robot.withdrawal(closure),
        Err(CorrectError::Withdrawn { correction: robot.log.len() as u64 - all.len() as u64 })
    );
    let positions: Vec<u64> = robot.mapper.map().corrections().map(|event| event.position).collect();
    if let [first, .., last] = positions[..] {
        assert_eq!(robot.undo(first), Err(CorrectError::Later { correction: first, later: last }));
    }
    positions.iter().rev().for_each(|&correction| robot.undo(correction).unwrap());
    assert_eq!(robot.mapper.state_hash(), hash);
    check_folds(&robot);
    assert_eq!(robot.undo(positions[0]), Err(CorrectError::Unknown { correction: positions[0] }));
}

#[test]
fn a_robot_that_is_still_there_goes_on_from_where_it_was_before() {
    let mut robot = Robot::new(again_after::<45>, PlanarPose::new(0.0, 0.0, 0.0), [0.0; 2]);
    robot.see();
    while robot.closures().is_empty() {
        ahead(&mut robot, 1);
        assert!(robot.log.len() < 110, "it was not deceived");
    }
    let hash = robot.mapper.state_hash();
    let closure = robot.closures()[0];
    let withdrawal = robot.withdraw(closure).unwrap();
    let resumed = withdrawal.resumed.unwrap();
    assert_ne!(resumed.stay.unwrap().place, withdrawal.place);
    let later = robot.event(closure).clone();
    let earlier = robot.event(withdrawal.earlier).clone();
    let pose = RelativePose::new(PlanarPose::identity(), nalgebra::Matrix3::identity() * 1e-4).unwrap();
    let measurement = Measurement { later: &later, before: None, earlier: &earlier, pose };
    assert_eq!(robot.mapper.measure(&measurement), Err(MeasureError::Withdrawn { which: "later" }));
    check_folds(&robot);

    // It is undone as if it had not been said.
    let correction = robot.log.len() as u64 - 1;
    let mut undone = robot.clone();
    undone.undo(correction).unwrap();
    assert_eq!(undone.mapper.state_hash(), hash);
    check_folds(&undone);

    // Past what looks twice.
    for _ in 0..4 {
        robot.go(0.6, 0.0);
        let last = robot.log.len() as u64 - 1;
        if robot.event(last).decision.reason == Reason::LoopClosure {
            robot.withdraw(last).unwrap();
        }
    }
    ahead(&mut robot, 6);
    assert_eq!(robot.places_off(0.2), []);
    check_folds(&robot);
    // Undone later, the way that it drove since stays.
    let corrections: Vec<u64> = robot.mapper.map().corrections().map(|event| event.position).collect();
    corrections.into_iter().rev().for_each(|correction| robot.undo(correction).unwrap());
    check_folds(&robot);
}

/// A robot that comes back, and whose closures are withdrawn, is back where the map had it once
/// somebody says so.
#[test]
fn two_places_that_are_one_are_linked_by_what_their_frames_measure() {
    let mut robot = Robot::new(unique, PlanarPose::new(0.0, 0.0, 0.0), [0.02, 0.004]);
    robot.see();
    ahead(&mut robot, 10);
    (0..3).for_each(|_| turn_left(&mut robot));
    // Far off the way that it came.
    ahead(&mut robot, 4);
    let last = robot.log.len() as u64 - 1;
    let first = frames(&robot.log).next().unwrap().frame;
    assert_ne!(robot.event(last).decision.place, robot.event(first).decision.place);
    let far = robot.confirmation(last, first);
    assert!(matches!(far, Err(CorrectError::Refused { .. })), "{far:?}");
    assert_eq!(robot.confirmation_by(last, first, None), Err(CorrectError::NoFeatures));
    assert_eq!(robot.confirmation(first, last), Err(CorrectError::NotEarlier));

    let hash = robot.mapper.state_hash();
    let near = TwoView { ..seen(unique, &PlanarPose::identity(), &PlanarPose::identity()) };
    let event = robot.confirmation_by(last, first, Some(near)).unwrap();
    let Correction::Confirmed(Confirmation { link: Some(link), .. }) = event.correction else { panic!() };
    assert!(matches!(link.kind, LinkKind::Closed(_)), "{link:?}");
    robot.correct(event);
    assert!(robot.mapper.map().linked(link.from).contains(&link.to));
    check_folds(&robot);
    let correction = robot.log.len() as u64 - 1;
    assert_eq!(robot.confirmation_by(last, first, Some(near)), Err(CorrectError::Confirmed { correction }));
    robot.undo(correction).unwrap();
    assert_eq!(robot.mapper.state_hash(), hash);
    check_folds(&robot);
}

#[test]
fn without_metres_confirmed_places_are_linked_and_no_more() {
    let mut robot = Robot::new(unique, PlanarPose::new(0.0, 0.0, 0.0), [0.0; 2]);
    robot.runs.get_mut(&0).unwrap().odometry = None;
    robot.see();
    ahead(&mut robot, 8);
    let (last, first) = (robot.log.len() as u64 - 1, 1);
    let event = robot.confirmation_by(last, first, None).unwrap();
    let Correction::Confirmed(Confirmation { link: Some(link), .. }) = event.correction else { panic!() };
    assert_eq!(link.kind, LinkKind::Session);
    robot.correct(event);
    check_folds(&robot);
    let same = robot.confirmation_by(first, first, None);
    assert_eq!(same, Err(CorrectError::NotEarlier));
}

#[test]
fn what_is_no_closure_is_not_withdrawn() {
    let mut robot = first(unique);
    let made = frames(&robot.log).next().unwrap().frame;
    assert_eq!(robot.withdrawal(made), Err(CorrectError::NoClosure { reason: Reason::NewPlace }));
    let before = robot.mapper.state_hash();
    let event = robot.mapper.undo(3, said());
    assert_eq!(event, Err(CorrectError::Unknown { correction: 3 }));
    // A log that corrects what is not there is damaged.
    let position = robot.mapper.map().events();
    let undoing = topomap::log::Undoing { correction: 3, place: None };
    let correction = Correction::Undone(undoing);
    let event = CorrectionEvent { position, session: 0, by: String::new(), said_ns: 0, correction };
    let refused = robot.mapper.apply(&MapEvent::Corrected(Box::new(event)));
    assert_eq!(refused, Err(FoldError::Correction { position }));
    assert_eq!(robot.mapper.state_hash(), before);
}

/// Withdraws and undoes here and there in a random drive; returns what stands.
fn corrected(wheels: Wheels, seed: u64, picks: &[prop::sample::Index]) -> Robot {
    let mut robot = take_turns(wheels, 3, seed);
    for (number, pick) in picks.iter().enumerate() {
        let standing: Vec<u64> = robot.mapper.map().corrections().map(|event| event.position).collect();
        let closures = robot.closures();
        if number % 3 == 2 && !standing.is_empty() {
            let _ = robot.undo(standing[pick.index(standing.len())]);
        } else if !closures.is_empty() {
            let _ = robot.withdraw(closures[pick.index(closures.len())]);
        }
        // And the robots drive on.
        if number % 2 == 1 {
            robot.session = pick.index(robot.mapper.map().next_session() as usize) as u32;
            ahead(&mut robot, 2);
        }
    }
    robot
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn corrections_fold_alike_live_replayed_and_restored(
        seed in any::<u64>(), picks in prop::collection::vec(any::<prop::sample::Index>(), 1..9),
    ) {
        for wheels in [Wheels::Read, Wheels::Unread] {
            check_folds(&corrected(wheels, seed, &picks));
        }
    }

    /// Whatever was corrected, undoing all of it in reverse comes back to the bit.
    #[test]
    fn undoing_in_reverse_returns_the_state_hash(
        seed in any::<u64>(), picks in prop::collection::vec(any::<prop::sample::Index>(), 1..7),
    ) {
        for wheels in [Wheels::Read, Wheels::Unread] {
            let mut robot = take_turns(wheels, 3, seed);
            let (hash, closures) = (robot.mapper.state_hash(), robot.closures());
            let mut said = Vec::new();
            for pick in picks.iter().filter(|_| !closures.is_empty()) {
                if robot.withdraw(closures[pick.index(closures.len())]).is_ok() {
                    said.push((robot.log.len() as u64 - 1, robot.mapper.state_hash()));
                }
            }
            while let Some((correction, now)) = said.pop() {
                prop_assert_eq!(robot.mapper.state_hash(), now);
                prop_assert_ne!(now, hash);
                robot.undo(correction).unwrap();
            }
            prop_assert_eq!(robot.mapper.state_hash(), hash);
            let standing: Vec<_> = robot.mapper.map().standing_links().map(|(_, link)| *link).collect();
            let plain: Vec<_> = robot.log.iter().filter_map(|event| match event {
                MapEvent::Frame(event) => event.link,
                MapEvent::Measured(event) => event.link,
                MapEvent::SessionOpened { .. } | MapEvent::Corrected(_) => None,
            }).collect();
            prop_assert_eq!(standing, plain);
        }
    }

    /// A log that is told anew has the corrections of what stays.
    #[test]
    fn told_anew_the_corrections_are_there(
        seed in any::<u64>(), picks in prop::collection::vec(any::<prop::sample::Index>(), 1..7), removed in 0..3u32,
    ) {
        for wheels in [Wheels::Read, Wheels::Unread] {
            let robot = corrected(wheels, seed, &picks);
            let same = without(&robot.log, &[]);
            prop_assert_eq!(&same.events, &robot.log);
            if removed >= robot.mapper.map().next_session() {
                continue;
            }
            let retold = without(&robot.log, &[removed]);
            let map = folded(&retold.events);
            // Frames that were withdrawn are at no place, or somebody else's word is gone with them.
            for event in frames(&robot.log) {
                let Some(&now) = retold.frames.get(&event.frame) else { continue };
                if robot.mapper.map().withdrawal_of(event.frame).is_some() {
                    let MapEvent::Frame(told) = &retold.events[now as usize] else { panic!() };
                    prop_assert!(told.decision.place.is_none() || map.map().withdrawal_of(now).is_some());
                }
            }
        }
    }
}

#[test]
fn a_merge_takes_the_corrections_of_both_along() {
    let (mut target, mut source) = (first(unique), second(unique));
    // Back over its own way, so that it closes loops.
    for robot in [&mut target, &mut source] {
        (0..2).for_each(|_| turn_left(robot));
        ahead(robot, 8);
        let closures = robot.closures();
        for &closure in closures.iter().take(1) {
            robot.withdraw(closure).unwrap();
        }
    }
    let joined = target.joined_by(&source, &plan(&source, &target));
    let stand = |robot: &Robot| robot.mapper.map().corrections().count();
    assert_eq!(stand(&joined), stand(&target) + stand(&source));
    check_folds(&joined);
    let retold = without(&joined.log, &[1]);
    assert_eq!(retold.events, target.log);
}
