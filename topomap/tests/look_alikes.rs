//! A map of places that words alone may not tell apart.

use crate::words::{WORDS, model_of, view_of};
use fabmap::model::Model;
use fabmap::observation::Observation;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{Placement, Similarity, TwoView, VerificationSettings, ViewMotion};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{FrameInput, Localizer, Mapper, Queried};
use topomap::settings::MapperSettings;

/// A map in the making. Frames of one place share words; what geometry finds is said by the place
/// that a frame truly shows, which words alone may not tell.
pub(crate) struct World {
    pub(crate) mapper: Mapper,
    pub(crate) log: Vec<MapEvent>,
    /// By frame: the truth.
    pub(crate) shows: Vec<u64>,
}

/// What the views are of: frames of one place have these inliers, others 3.
pub(crate) struct Truth<'a> {
    pub(crate) shows: &'a [u64],
    pub(crate) current: u64,
    pub(crate) inliers: u32,
    pub(crate) shift_widths: f64,
}

impl Views for Truth<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let same = self.shows[earlier as usize] == self.current;
        let inliers = if same { self.inliers } else { 3 };
        Some(plane(200, inliers, [self.shift_widths, 0.0]))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

pub(crate) fn plane(matches: u32, inliers: u32, translation_widths: [f64; 2]) -> TwoView {
    let motion = Similarity { rotation_rad: 0.1, ln_scale: -0.2, translation_widths };
    let motion = Some(ViewMotion::Similarity(motion));
    TwoView { matches, inliers, distinct_inliers: inliers, motion, placement: Placement::Unknown }
}

pub(crate) fn view(place: u64, noise: u64) -> Observation {
    view_of(place, 0.8, 6, &mut ChaCha8Rng::seed_from_u64(1_000_000 + noise))
}

pub(crate) fn model() -> Model {
    model_of((1000..1200).map(|place| view(place, place)).collect(), WORDS)
}

pub(crate) fn settings() -> MapperSettings {
    let verification = VerificationSettings::default();
    MapperSettings { guard_frames: 4, verification, ..MapperSettings::default() }
}

impl World {
    pub(crate) fn new(settings: MapperSettings) -> Self {
        let mut mapper = Mapper::new(&model(), settings).unwrap();
        let opened = MapEvent::SessionOpened { session: 0 };
        mapper.apply(&opened).unwrap();
        Self { mapper, log: vec![opened], shows: vec![u64::MAX] }
    }

    pub(crate) fn input(&self, place: u64) -> FrameInput {
        let sequence = self.log.len() as u64;
        let observation = view(place, sequence);
        FrameInput { session: 0, sequence, stamp_ns: sequence as i64, odometry: None, observation }
    }

    pub(crate) fn decide(&self, place: u64, views: &impl Views) -> FrameEvent {
        in_memory::decide(&self.mapper, &self.log, self.input(place), views, &mut ()).unwrap().event
    }

    pub(crate) fn see(&mut self, place: u64, views: impl Fn(&[u64]) -> FrameEventViews) -> FrameEvent {
        let FrameEventViews { inliers, shift_widths, truly } = views(&self.shows);
        let truly = truly.unwrap_or(place);
        let truth = Truth { shows: &self.shows, current: truly, inliers, shift_widths };
        let event = self.decide(place, &truth);
        let stored = MapEvent::Frame(Box::new(event.clone()));
        let read = MapEvent::from_bytes(&stored.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(read, stored, "the byte form keeps all");
        self.mapper.apply(&read).unwrap();
        self.log.push(read);
        self.shows.push(truly);
        event
    }

    pub(crate) fn sees(&mut self, place: u64, inliers: u32) -> FrameEvent {
        self.see(place, |_| FrameEventViews { inliers, shift_widths: 0.1, truly: None })
    }
}

impl World {
    /// Through places that geometry tells apart more or less well, some of them twice, some that
    /// only look alike.
    pub(crate) fn driven() -> Self {
        let mut world = Self::new(settings());
        (1..=8).for_each(|place| drop(world.sees(place, 40)));
        for (place, inliers, truly) in [
            (1, 40, 1),
            (2, 5, 2),
            (3, 190, 3),
            (4, 60, 99),
            (5, 30, 5),
            (5, 30, 5),
            (5, 3, 77),
            (6, 90, 6),
            (7, 90, 7),
            (8, 90, 8),
            (12, 20, 3),
            (13, 190, 4),
            (2, 0, 2),
            (2, 0, 98),
            (3, 120, 3),
            (4, 120, 4),
            (4, 120, 3),
        ] {
            let truly = Some(truly);
            world.see(place, |_| FrameEventViews { inliers, shift_widths: 0.1, truly });
        }
        world
    }

    pub(crate) fn truth(&self, current: u64, inliers: u32) -> Truth<'_> {
        Truth { shows: &self.shows, current, inliers, shift_widths: 0.1 }
    }

    /// Where a place was seen.
    pub(crate) fn query(&self, place: u64) -> Queried {
        in_memory::query(&self.mapper, &self.log, &view(place, 777), &self.truth(place, 40)).unwrap()
    }

    /// What a robot that only looks is told at some places.
    pub(crate) fn localized(&self, places: &[u64]) -> Vec<FrameEvent> {
        let mut localizer = Localizer::new();
        let mut events = Vec::new();
        for (step, &place) in places.iter().enumerate() {
            let (sequence, stamp_ns) = (step as u64 + 1, step as i64 + 1);
            let input = FrameInput { session: Localizer::SESSION, sequence, stamp_ns, ..self.input(place) };
            let truth = self.truth(place, 40);
            let event =
                in_memory::localize(&self.mapper, &localizer, &self.log, input, &truth).unwrap().event;
            localizer.follow(&event, &self.mapper);
            events.push(event);
        }
        events
    }
}

/// How the next frame compares.
pub(crate) struct FrameEventViews {
    pub(crate) inliers: u32,
    pub(crate) shift_widths: f64,
    /// The place that it truly shows, if that is not the one that its words are of.
    pub(crate) truly: Option<u64>,
}
