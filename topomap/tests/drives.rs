//! Drives through places that words tell apart.

use crate::words::{WORDS, model_of, view_of};
use fabmap::model::Model;
use fabmap::observation::Observation;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{TurnedView, TwoView};
use topomap::ids::FrameId;
use topomap::in_memory::{self, NoViews, Views};
use topomap::log::MapEvent;
use topomap::mapper::{FrameError, FrameInput, Mapper, Queried};
use topomap::metric::Odometry;
use topomap::settings::MapperSettings;

pub(crate) fn view(place: u64, noise: &mut ChaCha8Rng) -> Observation {
    view_of(place, 0.8, 6, noise)
}

pub(crate) fn model() -> Model {
    let noise = |place: u64| ChaCha8Rng::seed_from_u64(1_000_000 + place);
    model_of((1000..1200).map(|place| view(place, &mut noise(place))).collect(), WORDS)
}

pub(crate) fn settings() -> MapperSettings {
    MapperSettings { guard_frames: 4, ..MapperSettings::default() }
}

pub(crate) fn odometry(step: u64) -> Odometry {
    let angle = step as f64 * 0.1;
    Odometry::new([step as f64 * 0.5, 0.0, 0.0], [0.0, 0.0, angle.sin(), angle.cos()], None).unwrap()
}

/// Drives sessions through places; every third frame has odometry.
pub(crate) fn drive(mapper: &mut Mapper, log: &mut Vec<MapEvent>, steps: &[(u32, u64)], seed: u64) {
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
            in_memory::decide(mapper, log, input, &NoViews, &mut ()).unwrap().event,
        ));
        mapper.apply(&event).unwrap();
        log.push(event);
    }
}

/// A camera that sees all around, and has seen from here what `place` shows.
pub(crate) struct StandsAt(FrameId);

impl Views for StandsAt {
    fn compare(&self, _earlier: FrameId) -> Option<TwoView> {
        None
    }

    fn turned(&self, earlier: FrameId) -> Option<TurnedView> {
        let turned = if earlier == self.0 { 395 } else { 90 };
        Some(TurnedView { features: 500, matches: 400, turned })
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

/// Two sessions, then frames from the spot of frames 1, 1, 3, 6 and 1 of the log.
pub(crate) fn drive_and_stand(settings: MapperSettings) -> Vec<MapEvent> {
    let (mut mapper, mut log) = (Mapper::new(&model(), settings).unwrap(), Vec::new());
    drive(&mut mapper, &mut log, &[(0, 3), (1, 3)], 5);
    let mut noise = ChaCha8Rng::seed_from_u64(11);
    // Frames 0 and 2 of the log open sessions.
    for (step, views) in (10_u64..).zip([StandsAt(1), StandsAt(1), StandsAt(3), StandsAt(6), StandsAt(1)]) {
        let (observation, stamp_ns) = (view(3, &mut noise), step as i64 * 1_000_000_000);
        let input = FrameInput { session: 0, sequence: step, stamp_ns, odometry: None, observation };
        let decided = in_memory::decide(&mapper, &log, input, &views, &mut ()).unwrap().event;
        let event = MapEvent::Frame(Box::new(decided));
        mapper.apply(&event).unwrap();
        log.push(event);
    }
    let mut replayed = Mapper::new(&model(), settings).unwrap();
    replay(&mut replayed, &log);
    assert_eq!(replayed.state_hash(), mapper.state_hash());
    log
}

/// Where a place was seen, by words alone.
pub(crate) fn query(mapper: &Mapper, log: &[MapEvent], place: u64) -> Queried {
    let observation = view(place, &mut ChaCha8Rng::seed_from_u64(8));
    in_memory::query(mapper, log, &observation, &NoViews).unwrap()
}

pub(crate) fn replay<'a>(mapper: &mut Mapper, events: impl IntoIterator<Item = &'a MapEvent>) {
    for event in events {
        // Through the byte form: what the log keeps must be all there is.
        let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(&stored, event);
        mapper.apply(&stored).unwrap();
    }
}

pub(crate) fn one_frame(session: u32, sequence: u64, stamp_ns: i64, place: u64) -> FrameInput {
    let observation = view(place, &mut ChaCha8Rng::seed_from_u64(stamp_ns as u64));
    FrameInput { session, sequence, stamp_ns, odometry: None, observation }
}

/// A mapper with a log and an open session, one call a frame.
pub(crate) struct Robot {
    pub(crate) mapper: Mapper,
    pub(crate) log: Vec<MapEvent>,
}

impl Robot {
    pub(crate) fn new() -> Self {
        let mut robot = Self { mapper: Mapper::new(&model(), settings()).unwrap(), log: Vec::new() };
        robot.fold(MapEvent::SessionOpened { session: 0 });
        robot
    }

    pub(crate) fn fold(&mut self, event: MapEvent) {
        self.mapper.apply(&event).unwrap();
        self.log.push(event);
    }

    pub(crate) fn see(&mut self, input: FrameInput) -> topomap::log::FrameEvent {
        let event = in_memory::decide(&self.mapper, &self.log, input, &NoViews, &mut ()).unwrap().event;
        self.fold(MapEvent::Frame(Box::new(event.clone())));
        event
    }

    pub(crate) fn refusal(&self, input: FrameInput) -> FrameError {
        let before = self.mapper.state_hash();
        let refused = in_memory::decide(&self.mapper, &self.log, input, &NoViews, &mut ()).unwrap_err();
        assert_eq!(self.mapper.state_hash(), before);
        refused
    }
}
