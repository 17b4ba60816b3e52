//! The shipped drive, mapped in this process without any server.

use std::ops::RangeInclusive;
use std::sync::LazyLock;

use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use fabmap::observation::Observation;
use topomap::event::{FrameEvent, FrameId, MapEvent};
use topomap::mapper::{
    ArchiveError, Decided, FrameArchive, FrameInput, Localizer, Mapper, MapperSettings, Queried,
};
use waypost_vision::features::Extractor;

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

static REFERENCE: LazyLock<Reference> = LazyLock::new(|| {
    let model = Model::from_bytes(&std::fs::read(model_file()).unwrap()).unwrap();
    let observations = observe(&model);
    let mut mapper = Mapper::new(&model, MapperSettings::default()).unwrap();
    let opened = MapEvent::SessionOpened { session: 0 };
    mapper.apply(&opened).unwrap();
    let mut log = Log(vec![opened]);
    let (mut events, mut posteriors, mut maps) = (Vec::new(), Vec::new(), vec![MapState::of(&mapper)]);
    for (sequence, observation) in (1..=frame_count()).zip(observations) {
        let stamp_ns = frame(sequence).stamp_ns;
        let input = FrameInput { session: 0, sequence, stamp_ns, odometry: None, observation };
        let decided = mapper.decide(input, &log, &topomap::verification::NoViews, &mut ()).unwrap();
        let event = MapEvent::Frame(Box::new(decided.event.clone()));
        mapper.apply(&event).unwrap();
        log.0.push(event);
        events.push(decided.event);
        posteriors.push(decided.recognition.posterior.places);
        maps.push(MapState::of(&mapper));
    }
    Reference { events, posteriors, maps, log, model }
});

/// The shipped drive with the shipped model and default settings.
pub(crate) fn reference() -> &'static Reference {
    &REFERENCE
}

impl Reference {
    /// Sequence number of the frame at a position of the log.
    pub(crate) fn sequence_of(&self, frame: FrameId) -> u64 {
        self.log.frame(frame).expect("matches are frames").sequence
    }

    /// The model that all was decided by.
    pub(crate) fn model(&self) -> &Model {
        &self.model
    }

    /// The map after the first `frames`.
    pub(crate) fn mapper(&self, frames: u64) -> Mapper {
        let mut mapper = Mapper::new(&self.model, MapperSettings::default()).unwrap();
        self.fold_into(&mut mapper, frames);
        mapper
    }

    /// Folds the first `frames` into an empty map, also one over another model.
    pub(crate) fn fold_into(&self, mapper: &mut Mapper, frames: u64) {
        // The log begins with the opening of the session.
        self.log.0.iter().take(frames as usize + 1).for_each(|event| mapper.apply(event).unwrap());
    }

    /// What earlier frames showed.
    pub(crate) fn archive(&self) -> &dyn FrameArchive {
        &self.log
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
                let Decided { event, recognition: _ } = self.localize(&mapper, &localizer, sequence);
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
        mapper.localize(localizer, input, &self.log, &topomap::verification::NoViews, &mut ()).unwrap()
    }

    /// Where a frame is in the map of the first `mapped` ones, by its looks alone.
    pub(crate) fn queried(&self, mapped: u64, sequence: u64) -> Queried {
        self.mapper(mapped)
            .query(self.observation(sequence), &self.log, &topomap::verification::NoViews, &mut ())
            .unwrap()
    }

    /// The words of a frame.
    pub(crate) fn observation(&self, sequence: u64) -> &Observation {
        &self.events[sequence as usize - 1].observation
    }

    /// The most probable places of a frame, most probable first.
    pub(crate) fn most_probable(&self, frame: usize, count: usize) -> Vec<(PlaceId, f64)> {
        let mut places: Vec<(PlaceId, f64)> = (0..).zip(self.posteriors[frame].iter().copied()).collect();
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
fn observe(model: &Model) -> Vec<Observation> {
    let extractor = Extractor::new(model.extractor().parse().unwrap());
    let observe = |image: &Vec<u8>| {
        let (_, features) = extractor.extract_encoded(image).unwrap();
        model.vocabulary().observe(&features.descriptors).unwrap()
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
            MapEvent::SessionOpened { .. } => None,
            MapEvent::Frame(event) => Some(event),
        }
    }
}

impl FrameArchive for Log {
    fn observation(&self, frame: FrameId) -> Result<Option<Observation>, ArchiveError> {
        let why = || ArchiveError { frame, why: "it is no frame".to_owned() };
        self.frame(frame).map(|event| Some(event.observation.clone())).ok_or_else(why)
    }
}
