//! `waypost-eval scale`: what a filter update, a new place and a look cost, and what the index takes, as a
//! map grows; and how often a place is taken for another.

mod bail_out;
mod mistakes;
mod report;
mod source;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use fabmap::appearance::{Appearance, PlaceId};
use fabmap::baselines::DenseScorer;
use fabmap::codec::{Reader, Writer};
use fabmap::detector::DetectorModel;
use fabmap::inverted_index::InvertedIndex;
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::new_place::{NewPlace, NewPlaceMethod};
use fabmap::observation::Observation;
use fabmap::place_filter::{Belief, FilterSettings, MotionPrior, PlaceFilter};
use fabmap::recognizer::{Recognition, Recognizer, RecognizerSettings, Workspace};
use rayon::prelude::*;

use self::bail_out::BailOutReport;
use self::report::{GrowthPoint, ScaleReport};
use self::source::Source;
use crate::choices::{NEW_PLACE_METHODS, choice, name_of};
use crate::error::refused;
use crate::timing::{FrameWatch, mean, median, milliseconds};
use crate::workload::WorkloadSettings;
use crate::{files, memory, progress};

/// Grow a synthetic map and measure what a filter update, a new place and a look cost, and what the index takes.
///
/// A filter update is everything from a query's words to the normalised posterior and its top ten. With --out,
/// writes scale.json.
#[derive(Args)]
pub(crate) struct ScaleOptions {
    /// Places of the map.
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    places: u32,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "V", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
    words: u32,
    /// Threads that a query is spread over.
    #[arg(long, value_name = "T", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Most looks at a place: it is looked at from once to so often, and shows half of its words each time.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=15))]
    most_looks: u8,
    /// Observations in the sampling set.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Queries, revisits and new places in turn.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..))]
    queries: u32,
    /// Seed of tree, places and queries.
    #[arg(long, value_name = "S", default_value_t = WorkloadSettings::default().seed)]
    seed: u64,
    /// How places nobody has seen are stood in for.
    #[arg(long, value_parser = choice(NEW_PLACE_METHODS),
          default_value = name_of(NEW_PLACE_METHODS, &RecognizerSettings::default().new_place))]
    new_place: NewPlaceMethod,
    /// Compare the dense scorer with places dropped early and without; takes a byte for each word of each place.
    #[arg(long)]
    bail_out: bool,
    /// Ask the whole map the queries once more, each by itself, and count how often a place is taken for another.
    #[arg(long)]
    mistakes: bool,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Places added between two measurements of the clock's overhead, and drawn at once.
const CHUNK_PLACES: u32 = 4096;

/// The map is measured when it has these fractions of its places.
const GROWTH_STEPS: [u32; 5] = [16, 8, 4, 2, 1];

/// Most probable places that an update ends with.
const TOP_PLACES: usize = 10;

/// Places that are looked at once more at the end.
const UPDATED_PLACES: u32 = 2000;

/// Measures a map as it grows.
pub(crate) fn run(options: &ScaleOptions) -> Result<ScaleReport> {
    let source = Source::new(options)?;
    let training = source.training();
    let model = ObservationModel::new(source.tree(), DetectorModel::default(), Dependence::ChowLiu);
    let settings = RecognizerSettings { new_place: options.new_place, ..RecognizerSettings::default() };
    let recognizer = Recognizer::over(Arc::new(model), &training, settings).map_err(refused)?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(usize::from(options.threads)).build()?;
    let mut measurement = Measurement { source, recognizer, threads, adding_us: Vec::new() };
    let growth = measurement.growth();
    let bail_out =
        options.bail_out.then(|| measurement.bail_out(options.new_place, &training)).transpose()?;
    let mistakes = options.mistakes.then(|| {
        mistakes::count(&measurement.recognizer, &measurement.source.judged_queries(), &measurement.threads)
    });
    let report = ScaleReport { bail_out, mistakes, ..measurement.report(growth, options.threads) };
    if let Some(out) = &options.out {
        files::create_folder(out)?;
        files::write_json(&out.join("scale.json"), &report)?;
    }
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
        let places = self.source.places;
        let mut growth = Vec::new();
        for step in GROWTH_STEPS {
            self.grow((places / step).max(1));
            growth.push(self.query());
        }
        growth
    }

    fn bail_out(&self, new_place: NewPlaceMethod, training: &[Observation]) -> Result<BailOutReport> {
        let index = self.recognizer.index();
        let scorer = DenseScorer::new(index.model().clone(), &index.appearances().collect::<Vec<_>>());
        let new_place = NewPlace::new(new_place, index.model(), training)?;
        let filter = PlaceFilter::new(FilterSettings::default())?;
        let queries = self.source.queries(index.len() as u32);
        Ok(bail_out::compare(&scorer, &new_place, &filter, &queries, &self.threads))
    }

    fn report(mut self, growth: Vec<GrowthPoint>, threads: u16) -> ScaleReport {
        let rss_mib = memory::resident_mib();
        let index = self.recognizer.index();
        let words = index.model().vocabulary_len();
        let postings = index.postings();
        let per_posting = |bytes: usize| bytes as f64 / postings.max(1) as f64;
        let bytes_per_posting = per_posting(index.memory_bytes());
        let checkpoint = Checkpoint::of(index);
        let updating_us = self.look_again();
        let Self { recognizer, adding_us, .. } = self;
        let model = recognizer.index().model().clone();
        drop(recognizer);
        ScaleReport {
            whole: growth.last().cloned().unwrap_or_else(|| GrowthPoint::new(0, &[])),
            words,
            threads,
            add_place_us_mean: mean(&adding_us),
            add_place_us_p50: median(adding_us).unwrap_or(0.0),
            update_place_us_p50: median(updating_us).unwrap_or(0.0),
            postings,
            bytes_per_posting,
            checkpoint_bytes_per_posting: per_posting(checkpoint.rows.len()),
            rss_mib,
            open_ms: checkpoint.open_ms(&model),
            bail_out: None,
            mistakes: None,
            growth,
        }
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
                self.adding_us.push(1e3 * milliseconds(begun));
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
        let mut workspace = Workspace::default();
        let mut recognition = Recognition::default();
        for query in &queries {
            let mut watch = FrameWatch::start();
            let top = self.threads.install(|| {
                let motion = MotionPrior::from_weights(belief.places.clone(), belief.remainder);
                self.recognizer.recognize_into(query, &motion, &mut watch, &mut workspace, &mut recognition);
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
            1e3 * milliseconds(begun)
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
        milliseconds(begun)
    }
}
