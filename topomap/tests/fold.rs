//! A map is the fold of its log: live, replayed, and restored from a checkpoint it is the same.
#![expect(clippy::unwrap_used, reason = "a test's own inputs are valid")]

mod log_archive;
mod words;

use std::collections::BTreeMap;

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::model::Model;
use fabmap::observation::Observation;
use log_archive::LogArchive;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::checkpoint::{Block, BlockWriter, Changes, LINKS_PER_PIECE, Pieces, Restoration, decode_block};
use topomap::event::{FrameId, LinkKind, MapEvent, Reason};
use topomap::map::{Place, decode_place};
use topomap::mapper::{
    ArchiveError, FoldError, FrameError, FrameInput, Localizer, Mapper, MapperError, MapperSettings,
    PlaceRule, RestoreError,
};
use topomap::odometry::Odometry;
use topomap::standing::TurnedView;
use topomap::verification::{NoViews, TwoView, Views};
use words::{WORDS, model_of, view_of};

fn view(place: u64, noise: &mut ChaCha8Rng) -> Observation {
    view_of(place, 0.8, 6, noise)
}

fn model() -> Model {
    let noise = |place: u64| ChaCha8Rng::seed_from_u64(1_000_000 + place);
    model_of((1000..1200).map(|place| view(place, &mut noise(place))).collect(), WORDS)
}

fn settings() -> MapperSettings {
    MapperSettings { guard_frames: 4, ..MapperSettings::default() }
}

fn odometry(step: u64) -> Odometry {
    let angle = step as f64 * 0.1;
    Odometry::new([step as f64 * 0.5, 0.0, 0.0], [0.0, 0.0, angle.sin(), angle.cos()], None).unwrap()
}

/// Drives sessions through places; every third frame has odometry.
fn drive(mapper: &mut Mapper, log: &mut Vec<MapEvent>, steps: &[(u32, u64)], seed: u64) {
    let mut noise = ChaCha8Rng::seed_from_u64(seed);
    for (step, &(session, place)) in (1u64..).zip(steps) {
        while mapper.map().session(session).is_none() {
            let opened = MapEvent::SessionOpened { session: mapper.map().next_session() };
            mapper.apply(&opened).unwrap();
            log.push(opened);
        }
        let input = FrameInput {
            session,
            sequence: step * 2,
            stamp_ns: step as i64 * 1_000_000_000,
            odometry: step.is_multiple_of(3).then(|| odometry(step)),
            observation: view(place, &mut noise),
        };
        let event = MapEvent::Frame(Box::new(
            mapper.decide(input, &LogArchive(log), &NoViews, &mut ()).unwrap().event,
        ));
        mapper.apply(&event).unwrap();
        log.push(event);
    }
}

/// Whatever is recognised; but who only looks recognises as ever.
#[test]
fn each_frame_makes_a_place_where_that_is_the_rule() {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..settings() };
    let (mut mapper, mut log) = (Mapper::new(&model(), settings).unwrap(), Vec::new());
    // Without odometry: only every third frame of a drive has any, so each stands alone.
    drive(&mut mapper, &mut log, &[(0, 3), (0, 3), (0, 4), (0, 3), (1, 3), (1, 9), (1, 3)], 5);
    assert_eq!(mapper.map().places().len(), 7);
    let observation = view(9, &mut ChaCha8Rng::seed_from_u64(8));
    let found = mapper.query(&observation, &LogArchive(&log), &NoViews, &mut ()).unwrap();
    assert_eq!(found.recognition.posterior.best_place().map(|(place, _)| place), Some(5));
    // The log has it all.
    let mut replayed = Mapper::new(&model(), settings).unwrap();
    replay(&mut replayed, &log);
    assert_eq!(replayed.state_hash(), mapper.state_hash());
}

/// A camera that sees all around, and has seen from here what `place` shows.
struct StandsAt(FrameId);

impl Views for StandsAt {
    fn compare(&self, _earlier: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        Ok(None)
    }

    fn turned(&self, earlier: FrameId) -> Result<Option<TurnedView>, ArchiveError> {
        let turned = if earlier == self.0 { 395 } else { 90 };
        Ok(Some(TurnedView { features: 500, matches: 400, turned }))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

/// What is seen from the spot where the place's first frame was taken is another look at it, and logged as that.
#[test]
fn who_stands_makes_no_place_where_each_frame_does() {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..settings() };
    let (mut mapper, mut log) = (Mapper::new(&model(), settings).unwrap(), Vec::new());
    drive(&mut mapper, &mut log, &[(0, 3), (1, 3)], 5);
    let mut noise = ChaCha8Rng::seed_from_u64(11);
    let mut decisions = Vec::new();
    // Frames 0 and 2 of the log open sessions.
    for (step, views) in (10_u64..).zip([StandsAt(1), StandsAt(1), StandsAt(3), StandsAt(6), StandsAt(1)]) {
        let (observation, stamp_ns) = (view(3, &mut noise), step as i64 * 1_000_000_000);
        let input = FrameInput { session: 0, sequence: step, stamp_ns, odometry: None, observation };
        let decided = mapper.decide(input, &LogArchive(&log), &views, &mut ()).unwrap().event;
        decisions.push((decided.decision.reason, decided.decision.place));
        let event = MapEvent::Frame(Box::new(decided));
        mapper.apply(&event).unwrap();
        log.push(event);
    }
    let (same, new) = (Reason::SamePlace, Reason::NewPlace);
    let expected = [(same, Some(0)), (same, Some(0)), (new, Some(2)), (same, Some(2)), (new, Some(3))];
    assert_eq!(decisions, expected);
    let mut replayed = Mapper::new(&model(), settings).unwrap();
    replay(&mut replayed, &log);
    assert_eq!(replayed.state_hash(), mapper.state_hash());
}

fn replay<'a>(mapper: &mut Mapper, events: impl IntoIterator<Item = &'a MapEvent>) {
    for event in events {
        // Through the byte form: what the log keeps must be all there is.
        let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(&stored, event);
        mapper.apply(&stored).unwrap();
    }
}

/// A checkpoint as a disk would keep it.
#[derive(Default)]
struct Stored {
    head: Vec<u8>,
    sessions: BTreeMap<u32, Vec<u8>>,
    links: BTreeMap<u64, Vec<u8>>,
    blocks: Vec<Block>,
    /// Those that changed since they were sealed, or are not.
    places: BTreeMap<PlaceId, Vec<u8>>,
}

impl Stored {
    fn write(&mut self, pieces: Pieces) {
        let Pieces { events: _, head, sessions, links, places } = pieces;
        self.head = head;
        self.sessions.extend(sessions);
        self.links.extend(links);
        self.places.extend(places);
    }

    fn sealed(&self) -> PlaceId {
        self.blocks.last().map_or(0, |last| last.first + last.places)
    }

    /// All places in order, each as it was written last.
    fn all_places(&self) -> Vec<(Place, Appearance)> {
        let decode = |block: &Block| {
            let (first, places) = decode_block(&block.bytes, WORDS as usize).unwrap();
            assert_eq!((first, places.len()), (block.first, block.places as usize));
            places
        };
        let mut places: Vec<_> = self.blocks.iter().flat_map(decode).collect();
        for (&id, bytes) in &self.places {
            let place = decode_place(bytes, WORDS as usize).unwrap();
            if (id as usize) < places.len() { places[id as usize] = place } else { places.push(place) }
        }
        places
    }

    /// Seals the next `count` places, and the first block anew.
    fn seal(&mut self, count: usize) {
        let (sealed, places) = (self.sealed(), self.all_places());
        let seal = |first: PlaceId, count: usize| {
            let mut block = BlockWriter::new(first);
            places
                .iter()
                .skip(first as usize)
                .take(count)
                .for_each(|(place, appearance)| block.push(place, appearance));
            block.seal()
        };
        if let Some(first) = self.blocks.first_mut() {
            *first = seal(0, first.places as usize);
            self.places.retain(|&place, _| place >= first.places);
        }
        self.blocks.extend(Some(seal(sealed, count)).filter(|block| block.places > 0));
        let (before, after) = (sealed, self.sealed());
        self.places.retain(|&place, _| !(before..after).contains(&place));
    }

    fn restore(&self, model: &Model) -> Mapper {
        let mut restoration = Restoration::new(model, settings(), &self.head).unwrap();
        self.sessions.iter().for_each(|(&id, bytes)| restoration.session(id, bytes).unwrap());
        self.links.iter().for_each(|(&first, bytes)| restoration.links(first, bytes).unwrap());
        (0..).zip(self.all_places()).for_each(|(id, place)| restoration.place(id, place).unwrap());
        restoration.finish().unwrap()
    }
}

#[test]
fn pieces_that_do_not_add_up_are_no_map() {
    let (model, mut log) = (model(), Vec::new());
    let mut mapper = Mapper::new(&model, settings()).unwrap();
    drive(&mut mapper, &mut log, &[(0, 1), (0, 2), (0, 3), (1, 1), (1, 2)], 3);
    let mut changes = Changes::default();
    log.iter().for_each(|event| changes.follow(event));
    let pieces = mapper.pieces(&changes);
    let places: Vec<_> =
        pieces.places.iter().map(|(id, bytes)| (*id, decode_place(bytes, WORDS as usize).unwrap())).collect();
    let begin = || Restoration::new(&model, settings(), &pieces.head).unwrap();

    let mut gap = begin();
    gap.place(0, places[0].1.clone()).unwrap();
    assert_eq!(gap.place(2, places[2].1.clone()), Err(RestoreError::Missing { what: "places", from: 1 }));
    assert_eq!(gap.links(LINKS_PER_PIECE as u64, &[]), Err(RestoreError::Missing { what: "links", from: 0 }));
    assert_eq!(gap.finish().unwrap_err(), RestoreError::Missing { what: "places", from: 1 });

    let mut many = begin();
    places.iter().for_each(|(id, place)| many.place(*id, place.clone()).unwrap());
    pieces.links.iter().for_each(|(first, bytes)| many.links(*first, bytes).unwrap());
    pieces.sessions.iter().for_each(|(id, bytes)| many.session(*id, bytes).unwrap());
    many.session(7, &pieces.sessions[0].1).unwrap();
    assert_eq!(many.finish().unwrap_err(), RestoreError::TooMany { what: "sessions", expected: 2 });

    // A session's bytes are none of links, and no prefix of anything is whole.
    assert!(begin().links(0, &pieces.sessions[0].1).is_err());
    let block = mapper.blocks(usize::MAX).next().unwrap().bytes;
    for cut in 0..block.len() {
        assert!(decode_block(&block[..cut], WORDS as usize).is_err(), "{cut} of {} bytes", block.len());
    }
    let small: Vec<PlaceId> = mapper.blocks(1).map(|block| block.first).collect();
    assert_eq!(small, (0..mapper.map().places().len() as PlaceId).collect::<Vec<_>>());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn fold_replay_and_restore_agree(
        steps in proptest::collection::vec((0..3u32, 0..12u64), 1..60), cuts in proptest::collection::vec(any::<prop::sample::Index>(), 1..4), seed in any::<u64>(),
    ) {
        let model = model();
        let mut live = Mapper::new(&model, settings()).unwrap();
        let mut log = Vec::new();
        drive(&mut live, &mut log, &steps, seed);

        let mut replayed = Mapper::new(&model, settings()).unwrap();
        replay(&mut replayed, &log);
        prop_assert_eq!(replayed.state_hash(), live.state_hash());
        prop_assert_eq!(replayed.map(), live.map());

        // Checkpoints on the way, of what changed since the one before; some places are sealed in between.
        let mut half = Mapper::new(&model, settings()).unwrap();
        let (mut stored, mut events) = (Stored::default(), log.as_slice());
        for cut in cuts {
            let (now, later) = events.split_at(cut.index(events.len() + 1));
            let mut changes = Changes::since(half.map());
            now.iter().for_each(|event| changes.follow(event));
            replay(&mut half, now);
            stored.write(half.pieces(&changes));
            prop_assert_eq!(stored.restore(&model).state_hash(), half.state_hash());
            stored.seal(cut.index(5));
            prop_assert_eq!(stored.restore(&model).state_hash(), half.state_hash());
            events = later;
        }
        let mut restored = stored.restore(&model);
        prop_assert_eq!(restored.map(), half.map());
        replay(&mut restored, events);
        prop_assert_eq!(restored.state_hash(), live.state_hash());
        prop_assert_eq!(restored.map(), live.map());

        // And all three decide the next frame alike, to the bit.
        let next = FrameInput { session: steps[0].0, sequence: 10_000, stamp_ns: i64::MAX, odometry: None, observation: view(3, &mut ChaCha8Rng::seed_from_u64(seed)) };
        let decided = live.decide(next.clone(), &LogArchive(&log), &NoViews, &mut ()).unwrap();
        prop_assert_eq!(&replayed.decide(next.clone(), &LogArchive(&log), &NoViews, &mut ()).unwrap(), &decided);
        prop_assert_eq!(&restored.decide(next, &LogArchive(&log), &NoViews, &mut ()).unwrap(), &decided);
    }

    /// A robot that only looks is told what a new session would be told, and changes nothing.
    #[test]
    fn localizing_is_deciding_without_a_trace(
        steps in proptest::collection::vec((0..2u32, 0..8u64), 1..40), seen in proptest::collection::vec(0..10u64, 1..12), seed in any::<u64>(),
    ) {
        let mut mapper = Mapper::new(&model(), settings()).unwrap();
        let mut log = Vec::new();
        drive(&mut mapper, &mut log, &steps, seed);
        let (before, first) = (mapper.state_hash(), seen[0]);
        let mut localizer = Localizer::new();
        for (step, place) in (1i64..).zip(seen) {
            let input = one_frame(Localizer::SESSION, step as u64, step, place);
            let decided = mapper.localize(&localizer, input, &LogArchive(&log), &NoViews, &mut ()).unwrap();
            prop_assert!(!decided.event.learnt && decided.event.link.is_none());
            prop_assert!(decided.event.decision.place.is_none_or(|place| (place as usize) < mapper.recognizer().places()));
            localizer.follow(&decided.event, &mapper);
            prop_assert_eq!(localizer.last_sequence(), Some(step as u64));
        }
        prop_assert_eq!(mapper.state_hash(), before);

        let opened = mapper.map().next_session();
        let localized = mapper.localize(&Localizer::new(), one_frame(Localizer::SESSION, 1, 1, first), &LogArchive(&log), &NoViews, &mut ()).unwrap();
        mapper.apply(&MapEvent::SessionOpened { session: opened }).unwrap();
        let mapped = mapper.decide(one_frame(opened, 1, 1, first), &LogArchive(&log), &NoViews, &mut ()).unwrap();
        prop_assert_eq!(&localized.recognition, &mapped.recognition);
        prop_assert_eq!(localized.event.proposal, mapped.event.proposal);
        prop_assert_eq!(localized.event.decision.reason, mapped.event.decision.reason);
        prop_assert_eq!(localized.event.decision.closure, mapped.event.decision.closure);
    }

    #[test]
    fn damaged_events_are_refused_or_folded_but_never_panic(flip in any::<prop::sample::Index>(), bit in 0..8u8) {
        let model = model();
        let mut mapper = Mapper::new(&model, settings()).unwrap();
        let mut log = Vec::new();
        drive(&mut mapper, &mut log, &[(0, 1), (0, 2), (0, 1)], 5);
        let mut bytes = log.last().unwrap().to_bytes();
        let position = flip.index(bytes.len());
        bytes[position] ^= 1 << bit;
        let mut replayed = Mapper::new(&model, settings()).unwrap();
        replay(&mut replayed, &log[..log.len() - 1]);
        if let Ok(event) = MapEvent::from_bytes(&bytes, WORDS as usize) {
            let _ = replayed.apply(&event);
        }
    }
}

fn one_frame(session: u32, sequence: u64, stamp_ns: i64, place: u64) -> FrameInput {
    let observation = view(place, &mut ChaCha8Rng::seed_from_u64(stamp_ns as u64));
    FrameInput { session, sequence, stamp_ns, odometry: None, observation }
}

/// A mapper with a log and an open session, one call a frame.
struct Robot {
    mapper: Mapper,
    log: Vec<MapEvent>,
}

impl Robot {
    fn new() -> Self {
        let mut robot = Self { mapper: Mapper::new(&model(), settings()).unwrap(), log: Vec::new() };
        robot.fold(MapEvent::SessionOpened { session: 0 });
        robot
    }

    fn fold(&mut self, event: MapEvent) {
        self.mapper.apply(&event).unwrap();
        self.log.push(event);
    }

    fn see(&mut self, input: FrameInput) -> topomap::event::FrameEvent {
        let event = self.mapper.decide(input, &LogArchive(&self.log), &NoViews, &mut ()).unwrap().event;
        self.fold(MapEvent::Frame(Box::new(event.clone())));
        event
    }

    fn refusal(&self, input: FrameInput) -> FrameError {
        let before = self.mapper.state_hash();
        let refused = self.mapper.decide(input, &LogArchive(&self.log), &NoViews, &mut ()).unwrap_err();
        assert_eq!(self.mapper.state_hash(), before);
        refused
    }
}

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
    assert_eq!(map.linked(0), [1, 5]);
    // Two visits: one look of the first, at most three of the second.
    assert_eq!(robot.mapper.recognizer().index().appearance(0).unwrap().looks(), 4);
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
    assert_eq!((event.decision.reason, closure.place, closure.frame), (Reason::LoopClosure, 1, 2));
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
    assert!(matches!(robot.refusal(foreign), FrameError::ForeignWord { word: WORDS, .. }));
    robot.see(at(6, 0.5));
}

#[test]
fn events_that_are_not_next_are_refused() {
    let mut robot = Robot::new();
    let event = robot.see(one_frame(0, 1, 1, 1));
    let again = MapEvent::Frame(Box::new(event));
    assert_eq!(robot.mapper.apply(&again), Err(FoldError::Position { expected: 2, found: 1 }));
    let skipped = MapEvent::SessionOpened { session: 5 };
    assert_eq!(robot.mapper.apply(&skipped), Err(FoldError::Session { session: 5 }));
}

#[test]
fn settings_out_of_range_are_refused() {
    let model = model();
    let refused = |settings| Mapper::new(&model, settings).unwrap_err();
    for value in [0.0, 1.5, f64::NAN] {
        let threshold = MapperSettings { closure_threshold: value, ..settings() };
        assert!(matches!(refused(threshold), MapperError::ClosureThreshold { .. }));
    }
    assert_eq!(refused(MapperSettings { looks_per_stay: 0, ..settings() }), MapperError::LooksPerStay);
    let still = MapperSettings { max_speed_m_per_s: 0.0, ..settings() };
    assert_eq!(refused(still), MapperError::MaxSpeed { value: 0.0 });
}

/// Frames that version 1 logged: a new place with odometry, and a loop closure.
const LOGGED_BY_VERSION_1: &[u8] = include_bytes!("fixtures/log-v1.bin");

#[test]
fn a_log_of_version_1_still_folds() {
    let mut reader = fabmap::codec::Reader::new(LOGGED_BY_VERSION_1);
    let mut mapper = Mapper::new(&model(), settings()).unwrap();
    let mut reasons = Vec::new();
    while reader.remaining() > 0 {
        let event = MapEvent::from_bytes(reader.bytes().unwrap(), WORDS as usize).unwrap();
        if let MapEvent::Frame(frame) = &event {
            reasons.push(frame.decision.reason);
        }
        mapper.apply(&event).unwrap();
    }
    assert_eq!(reasons[..6], [Reason::NewPlace; 6]);
    assert_eq!(reasons[6..], [Reason::LoopClosure]);
    assert_eq!((mapper.recognizer().places(), mapper.map().links().len()), (6, 6));
}

#[test]
fn a_query_finds_the_place_and_its_gates_say_why() {
    let mut robot = Robot::new();
    for (step, place) in (1..).zip(1..=6) {
        robot.see(one_frame(0, step, step as i64, place));
    }
    let before = robot.mapper.state_hash();
    let again = one_frame(0, 100, 100, 2);
    let queried = robot.mapper.query(&again.observation, &LogArchive(&robot.log), &NoViews, &mut ()).unwrap();
    let matched = queried.matched.unwrap();
    assert_eq!((matched.place, matched.frame, queried.accepted), (1, 2, true));
    let decided = robot.mapper.decide(again.clone(), &LogArchive(&robot.log), &NoViews, &mut ()).unwrap();
    let gates = robot.mapper.gates(&again, &decided.recognition, matched.place).unwrap();
    // Left four frames ago, as the guard asks.
    assert_eq!((gates.guard.value, gates.guard.required), (6.0, 4.0));
    assert!(gates.words.passed && gates.known_place.passed && gates.guard.passed && gates.threshold.passed);
    let near = robot.mapper.gates(&again, &decided.recognition, 4).unwrap();
    assert_eq!((near.guard.passed, near.guard.value), (false, 1.0));
    assert!(!near.known_place.passed && !near.threshold.passed);
    assert_eq!(robot.mapper.gates(&again, &decided.recognition, 99), None);

    let nothing = Observation::from_words([1, 2], WORDS as usize).unwrap();
    let queried = robot.mapper.query(&nothing, &LogArchive(&robot.log), &NoViews, &mut ()).unwrap();
    assert_eq!((queried.matched, queried.accepted), (None, false));
    let foreign = Observation::from_words([WORDS], WORDS as usize + 1).unwrap();
    let refused = robot.mapper.query(&foreign, &LogArchive(&robot.log), &NoViews, &mut ());
    assert_eq!(refused, Err(FrameError::ForeignWord { word: WORDS, vocabulary_len: WORDS as usize }));
    assert_eq!(robot.mapper.state_hash(), before);
}
