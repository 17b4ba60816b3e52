//! The shipped drive, mapped in this process without any server.

use std::ops::RangeInclusive;
use std::sync::LazyLock;

use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use fabmap::observation::Observation;
use topomap::evidence::{TwoView, VerificationSettings};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{Decided, FrameInput, Localizer, Mapper, Queried};
use topomap::settings::MapperSettings;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, Features};
use waypost_vision::verification::{Verifier, View};

use super::{frame, frame_count, images, model_file};

/// What the frames of the shipped drive come to, streamed into one session of an empty map.
pub(crate) struct Reference {
    /// Per frame, what was decided.
    pub(crate) events: Vec<FrameEvent>,
    /// Per frame: the posterior of every place that was there.
    pub(crate) posteriors: Vec<Vec<f64>>,
    /// The map after so many frames: entry 0 is that of an open session without a frame.
    pub(crate) maps: Vec<MapState>,
    /// The log: what a frame number (its position) stands for.
    log: Log,
    model: Model,
    settings: MapperSettings,
}

/// What is to be compared of a map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MapState {
    pub(crate) state_hash: String,
    pub(crate) places: u64,
    pub(crate) links: u64,
}

#[derive(Clone, Debug, Default)]
struct Log(Vec<MapEvent>);

/// The words of every frame of the shipped drive, and where they are in the image.
struct Seen {
    model: Model,
    frames: Vec<(Observation, FeatureRecord)>,
}

static SEEN: LazyLock<Seen> = LazyLock::new(|| {
    let model = Model::from_bytes(&std::fs::read(model_file()).unwrap()).unwrap();
    let frames = observe(&model);
    Seen { model, frames }
});

static REFERENCE: LazyLock<Reference> = LazyLock::new(|| Reference::of(MapperSettings::default()));

static BY_WORDS: LazyLock<Reference> = LazyLock::new(|| {
    let (verification, closure_threshold) = (VerificationSettings::none(), BY_WORDS_THRESHOLD);
    Reference::of(MapperSettings { verification, closure_threshold, ..MapperSettings::default() })
});

/// Posterior from which maps that go by words alone close loops.
pub(crate) const BY_WORDS_THRESHOLD: f64 = 0.5;

/// Of the server's verifier.
const SEED: u64 = 0;

/// The shipped drive with the shipped model and default settings.
pub(crate) fn reference() -> &'static Reference {
    &REFERENCE
}

/// The same in a map of [`super::by_words_request`].
pub(crate) fn reference_by_words() -> &'static Reference {
    &BY_WORDS
}

/// A frame beside earlier ones of the shipped drive.
struct CurrentView<'a> {
    sequence: u64,
    log: &'a Log,
    verifier: Verifier,
}

impl Views for CurrentView<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let features = |sequence: u64| &SEEN.frames[sequence as usize - 1].1;
        let earlier = features(self.log.frame(earlier).expect("matches are frames").sequence);
        let view = |features| View { features, camera: None };
        Some(self.verifier.compare(view(earlier), view(features(self.sequence))))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

impl Reference {
    /// The drive in a map with such settings.
    pub(crate) fn of(settings: MapperSettings) -> Self {
        let model = SEEN.model.clone();
        let mut mapper = Mapper::new(&model, settings).unwrap();
        let opened = MapEvent::SessionOpened { session: 0 };
        mapper.apply(&opened).unwrap();
        let (events, posteriors, maps) = (Vec::new(), Vec::new(), vec![MapState::of(&mapper)]);
        let mut drive = Reference { events, posteriors, maps, log: Log(vec![opened]), model, settings };
        for (sequence, (observation, _)) in (1..=frame_count()).zip(&SEEN.frames) {
            let (stamp_ns, observation) = (frame(sequence).stamp_ns, observation.clone());
            let input = FrameInput { session: 0, sequence, stamp_ns, odometry: None, observation };
            let decided =
                in_memory::decide(&mapper, drive.log(), input, &drive.view(sequence), &mut ()).unwrap();
            let event = MapEvent::Frame(Box::new(decided.event.clone()));
            mapper.apply(&event).unwrap();
            drive.log.0.push(event);
            drive.events.push(decided.event);
            drive.posteriors.push(decided.recognition.posterior.places);
            drive.maps.push(MapState::of(&mapper));
        }
        drive
    }

    fn view(&self, sequence: u64) -> CurrentView<'_> {
        CurrentView { sequence, log: &self.log, verifier: Verifier::new(self.settings.verification, SEED) }
    }

    /// Sequence number of the frame at a position of the log.
    pub(crate) fn sequence_of(&self, frame: FrameId) -> u64 {
        self.log.frame(frame).expect("matches are frames").sequence
    }

    /// All events.
    pub(crate) fn log(&self) -> &[MapEvent] {
        &self.log.0
    }

    /// The map's.
    pub(crate) fn settings(&self) -> MapperSettings {
        self.settings
    }

    /// The model that all was decided by.
    pub(crate) fn model(&self) -> &Model {
        &self.model
    }

    /// The map after the first `frames`.
    pub(crate) fn mapper(&self, frames: u64) -> Mapper {
        let mut mapper = Mapper::new(&self.model, self.settings).unwrap();
        self.fold_into(&mut mapper, frames);
        mapper
    }

    /// Folds the first `frames` into an empty map, also one over another model.
    pub(crate) fn fold_into(&self, mapper: &mut Mapper, frames: u64) {
        // The log begins with the opening of the session.
        self.log.0.iter().take(frames as usize + 1).for_each(|event| mapper.apply(event).unwrap());
    }

    /// What a robot hears that localizes, stage by stage: in the map of the first so many frames, by some
    /// frames.
    pub(crate) fn localized(
        &self,
        stages: impl IntoIterator<Item = (u64, RangeInclusive<u64>)>,
    ) -> Vec<FrameEvent> {
        let (mut localizer, mut events) = (Localizer::new(), Vec::new());
        for (mapped, sequences) in stages {
            let mapper = self.mapper(mapped);
            for sequence in sequences {
                let Decided { event, .. } = self.localize(&mapper, &localizer, sequence);
                localizer.follow(&event, &mapper);
                events.push(event);
            }
        }
        events
    }

    fn localize(&self, mapper: &Mapper, localizer: &Localizer, sequence: u64) -> Decided {
        let input = FrameInput {
            session: Localizer::SESSION,
            sequence,
            stamp_ns: frame(sequence).stamp_ns,
            odometry: None,
            observation: self.observation(sequence).clone(),
        };
        in_memory::localize(mapper, localizer, self.log(), input, &self.view(sequence)).unwrap()
    }

    /// Where a frame is in the map of the first `mapped` ones, by its looks alone.
    pub(crate) fn queried(&self, mapped: u64, sequence: u64) -> Queried {
        let views = self.view(sequence);
        in_memory::query(&self.mapper(mapped), self.log(), self.observation(sequence), &views).unwrap()
    }

    /// The words of a frame.
    pub(crate) fn observation(&self, sequence: u64) -> &Observation {
        &self.events[sequence as usize - 1].observation
    }

    /// The most probable places of a frame, most probable first.
    pub(crate) fn most_probable(&self, frame: usize, count: usize) -> Vec<(PlaceId, f64)> {
        let mut places: Vec<(PlaceId, f64)> =
            PlaceId::all().zip(self.posteriors[frame].iter().copied()).collect();
        places.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        places.truncate(count);
        places
    }
}

impl MapState {
    fn of(mapper: &Mapper) -> Self {
        Self {
            state_hash: mapper.state_hash().to_string(),
            places: mapper.map().places().len() as u64,
            links: mapper.map().links().len() as u64,
        }
    }
}

/// Decode, extract, quantize; two images at a time.
fn observe(model: &Model) -> Vec<(Observation, FeatureRecord)> {
    let extractor = Extractor::new(model.extractor().parse().unwrap());
    let observe = |image: &Vec<u8>| {
        let (image, Features { keypoints, descriptors }) = extractor.extract_encoded(image).unwrap();
        let words = model.vocabulary().words(&descriptors).unwrap();
        let observation = Observation::from_words(words.iter().copied(), model.vocabulary().len()).unwrap();
        let size_px = (image.width(), image.height());
        (observation, FeatureRecord::new(size_px, keypoints, words, Some(descriptors)).unwrap())
    };
    let (first, second) = images().split_at(images().len() / 2);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| first.iter().map(observe).collect::<Vec<_>>());
        let second: Vec<_> = second.iter().map(observe).collect();
        [first.join().unwrap(), second].concat()
    })
}

impl Log {
    fn frame(&self, frame: FrameId) -> Option<&FrameEvent> {
        match self.0.get(usize::try_from(frame).ok()?)? {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
            MapEvent::Frame(event) => Some(event),
        }
    }
}
