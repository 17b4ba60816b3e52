//! `waypost-eval scale`: what a filter update, a new place and a look cost, and what the index takes, as a
//! map grows.

mod bail_out;
mod report;

pub use bail_out::BailOutReport;
pub use report::{GrowthPoint, ScaleReport};

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::bail_out::DenseScorer;
use fabmap::chow_liu::ChowLiuTree;
use fabmap::codec::{Reader, Writer};
use fabmap::detector::DetectorModel;
use fabmap::inverted_index::InvertedIndex;
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::new_place::{NewPlace, NewPlaceMethod};
use fabmap::observation::Observation;
use fabmap::place_filter::{Belief, FilterSettings, MotionPrior, PlaceFilter};
use fabmap::recognizer::{Recognition, Recognizer, RecognizerSettings, Stage, StageObserver, Workspace};
use rayon::prelude::*;
use topomap::mapper::MapperError;

use crate::error::EvalError;
use crate::workload::files::WorkloadFiles;
use crate::workload::{Use, Workload, WorkloadSettings};
use crate::{memory, progress};

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleOptions {
    /// Where places and queries come from.
    pub source: ScaleSource,
    /// Threads that a query is spread over, at least 1.
    pub threads: usize,
    /// How "somewhere new" is stood in for.
    pub new_place: NewPlaceMethod,
    /// What to compare on the whole map beside the index.
    pub compared: Compared,
    /// Folder for the results; `None` writes none.
    pub out: Option<PathBuf>,
}

/// What is compared on the whole map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compared {
    /// The index alone is measured.
    Nothing,
    /// The dense scorer with places dropped early against without; it takes a byte for each word of each place.
    BailOut,
}

/// Where places and queries come from.
#[derive(Clone, Debug, PartialEq)]
pub enum ScaleSource {
    /// Drawn at random.
    Drawn {
        /// The distribution and its seed.
        settings: WorkloadSettings,
        /// Places of the map, at least 1.
        places: u32,
        /// Place i is looked at 1 + i mod `most_looks` times; at least 1.
        most_looks: u8,
        /// Observations in the sampling set, at least 1.
        samples: u32,
        /// Queries: revisits and new places in turn.
        queries: u32,
    },
    /// Read from the files of the numpy generator.
    Files(PathBuf),
}

/// Places added between two measurements of the clock's overhead, and drawn at once.
const CHUNK_PLACES: u32 = 4096;

/// The map is measured when it has these fractions of its places.
const GROWTH_STEPS: [u32; 5] = [16, 8, 4, 2, 1];

/// Most probable places that an update ends with.
const TOP_PLACES: usize = 10;

/// Places that are looked at once more at the end.
const UPDATED_PLACES: u32 = 2000;

/// Where the map's places and the queries come from, one by one.
enum Source {
    Drawn { workload: Box<Workload>, places: u32, most_looks: u8, queries: u32 },
    Files { places: Vec<Observation>, queries: Vec<Observation> },
}

/// Measures a map as it grows.
///
/// # Errors
/// [`EvalError`] if the workload cannot be had, or the results cannot be written.
pub fn run(options: &ScaleOptions) -> Result<ScaleReport, EvalError> {
    let (source, tree, training) = Source::open(&options.source)?;
    let model = ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu);
    let settings = RecognizerSettings { new_place: options.new_place, ..RecognizerSettings::default() };
    let recognizer = Recognizer::over(Arc::new(model), &training, settings).map_err(MapperError::from)?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(options.threads).build()?;
    let mut measurement = Measurement { source, recognizer, threads, adding_us: Vec::new() };
    let growth = measurement.growth();
    let bail_out = match options.compared {
        Compared::Nothing => None,
        Compared::BailOut => Some(measurement.bail_out(options.new_place, &training)?),
    };
    let report = ScaleReport { bail_out, ..measurement.report(growth, options.threads) };
    report.write(options.out.as_deref())?;
    Ok(report)
}

/// A map that grows, and what has been measured of it.
struct Measurement {
    source: Source,
    recognizer: Recognizer,
    /// Queries run here; places are drawn on all processors.
    threads: rayon::ThreadPool,
    adding_us: Vec<f64>,
}

impl Measurement {
    fn growth(&mut self) -> Vec<GrowthPoint> {
        let places = self.source.places();
        let mut growth = Vec::new();
        for step in GROWTH_STEPS {
            self.grow((places / step).max(1));
            growth.push(self.query());
        }
        growth
    }

    fn bail_out(
        &self,
        new_place: NewPlaceMethod,
        training: &[Observation],
    ) -> Result<BailOutReport, EvalError> {
        let index = self.recognizer.index();
        let scorer = DenseScorer::new(index.model().clone(), &index.appearances().collect::<Vec<_>>());
        let new_place = NewPlace::new(new_place, index.model(), training)?;
        let filter = PlaceFilter::new(FilterSettings::default()).map_err(EvalError::Filter)?;
        let queries = self.source.queries(index.len() as u32);
        Ok(bail_out::compare(&scorer, &new_place, &filter, &queries, &self.threads))
    }

    fn report(mut self, growth: Vec<GrowthPoint>, threads: usize) -> ScaleReport {
        let rss_mib = memory::resident_mib();
        let index = self.recognizer.index();
        let (words, postings) = (index.model().vocabulary_len(), index.postings());
        let index_bytes = index.memory_bytes();
        let checkpoint = Checkpoint::of(index);
        let updating_us = self.look_again();
        let Self { recognizer, adding_us, .. } = self;
        let model = recognizer.index().model().clone();
        drop(recognizer);
        let open_ms = checkpoint.open_ms(&model);
        ScaleReport::new(report::Measures {
            words,
            threads,
            growth,
            adding_us,
            updating_us,
            postings,
            index_bytes,
            checkpoint_bytes: checkpoint.rows.len(),
            rss_mib,
            open_ms,
        })
    }

    /// Adds places until there are `places`.
    fn grow(&mut self, places: u32) {
        let bar = progress::bar("places", places as usize);
        let mut next = self.recognizer.places() as u32;
        while next < places {
            let end = places.min(next + CHUNK_PLACES);
            let looks: Vec<Vec<Observation>> =
                (next..end).into_par_iter().map(|place| self.source.looks(place)).collect();
            for looks in looks {
                let begun = Instant::now();
                let place = self.recognizer.add_place(&Appearance::of(&looks[0]));
                self.adding_us.push(microseconds(begun));
                looks[1..].iter().for_each(|look| self.recognizer.observe_place(place, look));
            }
            bar.set_position(u64::from(end));
            next = end;
        }
        bar.finish_and_clear();
    }

    /// Everything from a query's words to the posterior's top: the belief carried from the query before is
    /// the motion prior.
    fn query(&self) -> GrowthPoint {
        let places = self.recognizer.places();
        let queries = self.source.queries(places as u32);
        let mut times = Vec::with_capacity(queries.len());
        let mut belief = Belief::unknown();
        let (mut workspace, mut recognition) = (Workspace::default(), Recognition::default());
        for query in &queries {
            let mut watch = StageWatch::start();
            let top = self.threads.install(|| {
                let motion = MotionPrior::from_weights(belief.places.clone(), belief.remainder);
                let (workspace, recognition) = (&mut workspace, &mut recognition);
                self.recognizer.recognize_into(query, &motion, &mut watch, workspace, recognition);
                recognition.posterior.top(TOP_PLACES)
            });
            times.push(watch.stop());
            // So that it is not left out.
            std::hint::black_box(top);
            belief = recognition.posterior.carry(None);
        }
        GrowthPoint::new(places, &times)
    }

    /// One more look, 300 words of which half are new, at places all over the map.
    fn look_again(&mut self) -> Vec<f64> {
        let places = self.recognizer.places() as u32;
        let looks = self.source.revisits(UPDATED_PLACES.min(places), places);
        let observe = |(place, look): (PlaceId, Observation)| {
            let begun = Instant::now();
            self.recognizer.observe_place(place, &look);
            microseconds(begun)
        };
        looks.into_iter().map(observe).collect()
    }
}

/// The places' appearances as a checkpoint's rows hold them.
struct Checkpoint {
    rows: Vec<u8>,
    places: usize,
}

impl Checkpoint {
    fn of(index: &InvertedIndex) -> Self {
        let mut writer = Writer::default();
        index.appearances().for_each(|appearance| appearance.encode_packed(&mut writer));
        Self { rows: writer.into_bytes(), places: index.len() }
    }

    fn open_ms(&self, model: &Arc<ObservationModel>) -> f64 {
        let begun = Instant::now();
        let mut index = InvertedIndex::new(model.clone());
        let mut reader = Reader::new(&self.rows);
        let decode = |_| match Appearance::decode_packed(&mut reader, model.vocabulary_len()) {
            Ok(appearance) => appearance,
            Err(error) => unreachable!("what has just been encoded is decoded: {error}"),
        };
        index.extend((0..self.places).map(decode));
        begun.elapsed().as_secs_f64() * 1e3
    }
}

/// When the stages of one update ended.
struct StageWatch {
    begun: Instant,
    stage_begun: Instant,
    times: StageTimes,
}

/// Times of one update, in milliseconds.
#[derive(Clone, Copy, Debug, Default)]
struct StageTimes {
    likelihood_ms: f64,
    new_place_ms: f64,
    update_ms: f64,
}

impl StageWatch {
    fn start() -> Self {
        let begun = Instant::now();
        Self { begun, stage_begun: begun, times: StageTimes::default() }
    }

    fn stop(self) -> StageTimes {
        StageTimes { update_ms: milliseconds(self.begun.elapsed()), ..self.times }
    }
}

impl StageObserver for StageWatch {
    fn completed(&mut self, stage: Stage) {
        let now = Instant::now();
        let elapsed = milliseconds(now - std::mem::replace(&mut self.stage_begun, now));
        match stage {
            Stage::Likelihood => self.times.likelihood_ms = elapsed,
            Stage::NewPlace => self.times.new_place_ms = elapsed,
            Stage::Filter | Stage::Verification => {}
        }
    }
}

impl Source {
    fn open(source: &ScaleSource) -> Result<(Self, ChowLiuTree, Vec<Observation>), EvalError> {
        match source {
            ScaleSource::Drawn { settings, places, most_looks, samples, queries } => {
                let workload = Workload::new(*settings)?;
                let (tree, training) = (workload.tree().clone(), workload.images(Use::Training, *samples));
                let (places, most_looks, queries) = (*places, *most_looks, *queries);
                Ok((
                    Self::Drawn { workload: Box::new(workload), places, most_looks, queries },
                    tree,
                    training,
                ))
            }
            ScaleSource::Files(folder) => {
                let WorkloadFiles { tree, places, training, queries } = WorkloadFiles::open(folder)?;
                let queries = queries.into_iter().map(|query| query.observation).collect();
                Ok((Self::Files { places, queries }, tree, training))
            }
        }
    }

    fn places(&self) -> u32 {
        match self {
            Self::Drawn { places, .. } => *places,
            Self::Files { places, .. } => places.len() as u32,
        }
    }

    /// What is seen of a place, look by look.
    fn looks(&self, place: u32) -> Vec<Observation> {
        match self {
            Self::Drawn { workload, most_looks, .. } => {
                workload.looks(place, 1 + (place % u32::from(*most_looks)) as u8)
            }
            Self::Files { places, .. } => vec![places[place as usize].clone()],
        }
    }

    /// The queries of a map of the first `places` places.
    fn queries(&self, places: u32) -> Vec<Observation> {
        match self {
            Self::Drawn { workload, queries, .. } => {
                let query = |index: u32| match index % 2 {
                    0 => workload.revisit_to_one_of(index, places).observation,
                    _ => workload.image(Use::NewQuery, index),
                };
                (0..*queries).into_par_iter().map(query).collect()
            }
            Self::Files { queries, .. } => queries.clone(),
        }
    }

    /// Looks at places all over the map; those of files are other places' words, as good for measuring.
    fn revisits(&self, count: u32, places: u32) -> Vec<(PlaceId, Observation)> {
        let chosen = |index: u32| (u64::from(index) * u64::from(places) / u64::from(count)) as u32;
        match self {
            Self::Drawn { workload, .. } => {
                let look = |index| (chosen(index), workload.revisit_to(index, chosen(index)));
                (0..count).into_par_iter().map(look).collect()
            }
            Self::Files { queries, .. } => {
                let looks = queries.iter().cycle();
                (0..count).zip(looks).map(|(index, look)| (chosen(index), look.clone())).collect()
            }
        }
    }
}

fn microseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e6
}

fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
