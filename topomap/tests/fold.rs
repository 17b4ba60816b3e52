//! A map is the fold of its log: live, replayed, and restored from a checkpoint it is the same.

use std::collections::BTreeMap;

use crate::words::WORDS;
use fabmap::appearance::{Appearance, PlaceId};
use fabmap::model::Model;
use fabmap::observation::{Observation, WordId};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::checkpoint::{Block, BlockWriter, Changes, LINKS_PER_PIECE, Pieces, Restoration, decode_block};
use topomap::in_memory::{self, NoViews};
use topomap::log::{MapEvent, Reason};
use topomap::map::{Place, decode_place};
use topomap::mapper::{FoldError, FrameError, FrameInput, Localizer, Mapper, RestoreError};
use topomap::settings::{MapperError, MapperSettings, PlaceRule};

use crate::drives::{Robot, drive, drive_and_stand, model, one_frame, query, replay, settings, view};

/// Whatever is recognised; but who only looks recognises as ever.
#[test]
fn each_frame_makes_a_place_where_that_is_the_rule() {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..settings() };
    let (mut mapper, mut log) = (Mapper::new(&model(), settings).unwrap(), Vec::new());
    // Without odometry: only every third frame of a drive has any, so each stands alone.
    drive(&mut mapper, &mut log, &[(0, 3), (0, 3), (0, 4), (0, 3), (1, 3), (1, 9), (1, 3)], 5);
    assert_eq!(mapper.map().places().len(), 7);
    let found = query(&mapper, &log, 9);
    assert_eq!(found.recognition.posterior.best_place().map(|(place, _)| place), Some(PlaceId::new(5)));
    // The log has it all.
    let mut replayed = Mapper::new(&model(), settings).unwrap();
    replay(&mut replayed, &log);
    assert_eq!(replayed.state_hash(), mapper.state_hash());
}

/// What is seen from the spot where the place's first frame was taken is another look at it, and
/// logged as that.
#[test]
fn who_stands_makes_no_place_where_each_frame_does() {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..settings() };
    let log = drive_and_stand(settings);
    let decided = log.iter().rev().take(5).rev().filter_map(|event| match event {
        MapEvent::Frame(event) => Some((event.decision.reason, event.decision.place)),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    });
    let (same, new) = (Reason::SamePlace, Reason::NewPlace);
    let expected = [(same, 0), (same, 0), (new, 2), (same, 2), (new, 3)]
        .map(|(reason, place)| (reason, Some(PlaceId::new(place))));
    assert_eq!(decided.collect::<Vec<_>>(), expected);
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
        self.blocks.last().map_or(PlaceId::new(0), |last| PlaceId::new(last.places).counted_from(last.first))
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
            if id.index() < places.len() { places[id.index()] = place } else { places.push(place) }
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
                .skip(first.index())
                .take(count)
                .for_each(|(place, appearance)| block.push(place, appearance));
            block.seal()
        };
        if let Some(first) = self.blocks.first_mut() {
            *first = seal(PlaceId::new(0), first.places as usize);
            self.places.retain(|&place, _| place >= PlaceId::new(first.places));
        }
        self.blocks.extend(Some(seal(sealed, count)).filter(|block| block.places > 0));
        let (before, after) = (sealed, self.sealed());
        self.places.retain(|&place, _| !(before..after).contains(&place));
    }

    fn restore(&self, model: &Model) -> Mapper {
        let mut restoration = Restoration::new(model, settings(), &self.head).unwrap();
        self.sessions.iter().for_each(|(&id, bytes)| restoration.session(id, bytes).unwrap());
        self.links.iter().for_each(|(&first, bytes)| restoration.links(first, bytes).unwrap());
        (0..)
            .zip(self.all_places())
            .for_each(|(id, place)| restoration.place(PlaceId::new(id), place).unwrap());
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
    gap.place(PlaceId::new(0), places[0].1.clone()).unwrap();
    assert_eq!(
        gap.place(PlaceId::new(2), places[2].1.clone()),
        Err(RestoreError::Missing { what: "places", from: 1 })
    );
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
    assert_eq!(small, PlaceId::first(mapper.map().places().len()).collect::<Vec<_>>());
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

        // Checkpoints on the way, of what changed since the one before; some places are sealed in
        // between.
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
        let decided = in_memory::decide(&live, &log, next.clone(), &NoViews, &mut ()).unwrap();
        prop_assert_eq!(&in_memory::decide(&replayed, &log, next.clone(), &NoViews, &mut ()).unwrap(), &decided);
        prop_assert_eq!(&in_memory::decide(&restored, &log, next, &NoViews, &mut ()).unwrap(), &decided);
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
            let decided = in_memory::localize(&mapper, &localizer, &log, input, &NoViews).unwrap();
            prop_assert!(!decided.event.learnt && decided.event.link.is_none());
            prop_assert!(decided.event.decision.place.is_none_or(|place| (place.index()) < mapper.recognizer().places()));
            localizer.follow(&decided.event, &mapper);
            prop_assert_eq!(localizer.last_sequence(), Some(step as u64));
        }
        prop_assert_eq!(mapper.state_hash(), before);

        let opened = mapper.map().next_session();
        let localized = in_memory::localize(&mapper, &Localizer::new(), &log, one_frame(Localizer::SESSION, 1, 1, first), &NoViews).unwrap();
        mapper.apply(&MapEvent::SessionOpened { session: opened }).unwrap();
        let mapped = in_memory::decide(&mapper, &log, one_frame(opened, 1, 1, first), &NoViews, &mut ()).unwrap();
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
    let queried = in_memory::query(&robot.mapper, &robot.log, &again.observation, &NoViews).unwrap();
    let matched = queried.matched.unwrap();
    assert_eq!((matched.place, matched.frame, queried.accepted), (PlaceId::new(1), 2, true));
    let decided = in_memory::decide(&robot.mapper, &robot.log, again.clone(), &NoViews, &mut ()).unwrap();
    let gates = robot.mapper.gates(&again, &decided.recognition, matched.place).unwrap();
    // Left four frames ago, as the guard asks.
    assert_eq!((gates.guard.value, gates.guard.required), (6.0, 4.0));
    assert!(gates.words.passed && gates.known_place.passed && gates.guard.passed && gates.threshold.passed);
    let near = robot.mapper.gates(&again, &decided.recognition, PlaceId::new(4)).unwrap();
    assert_eq!((near.guard.passed, near.guard.value), (false, 1.0));
    assert!(!near.known_place.passed && !near.threshold.passed);
    assert_eq!(robot.mapper.gates(&again, &decided.recognition, PlaceId::new(99)), None);

    let nothing = Observation::from_words([1, 2], WORDS as usize).unwrap();
    let queried = in_memory::query(&robot.mapper, &robot.log, &nothing, &NoViews).unwrap();
    assert_eq!((queried.matched, queried.accepted), (None, false));
    let foreign = Observation::from_words([WORDS], WORDS as usize + 1).unwrap();
    let refused = in_memory::query(&robot.mapper, &robot.log, &foreign, &NoViews);
    assert_eq!(
        refused,
        Err(FrameError::ForeignWord { word: WordId::new(WORDS), vocabulary_len: WORDS as usize })
    );
    assert_eq!(robot.mapper.state_hash(), before);
}
