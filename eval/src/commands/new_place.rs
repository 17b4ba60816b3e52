//! `waypost-eval new-place`: how often a place nobody has seen is taken for a known one, by size of
//! the map.

mod report;

pub use report::{MapSizeReport, MethodReport, NewPlaceReport};

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use fabmap::appearance::Appearance;
use fabmap::chow_liu::ChowLiuTree;
use fabmap::detector::DetectorModel;
use fabmap::inverted_index::{InvertedIndex, QueryWeights};
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::new_place::{NewPlace, SampleWorkspace};
use fabmap::observation::Observation;
use fabmap::place_filter::{FilterSettings, MotionPrior, PlaceDistribution, PlaceFilter};

use crate::choices::NEW_PLACE_METHODS;
use crate::error::EvalError;
use crate::progress;
use crate::workload::files::{Query, WorkloadFiles};
use crate::workload::{Use, Workload, WorkloadSettings};

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct NewPlaceOptions {
    /// Where places and queries come from.
    pub source: WorkloadSource,
    /// Posterior from which the most probable place is accepted.
    pub threshold: f64,
    /// Folder for the results; `None` writes none.
    pub out: Option<PathBuf>,
}

/// Where places and queries come from.
#[derive(Clone, Debug, PartialEq)]
pub enum WorkloadSource {
    /// Drawn at random.
    Drawn {
        /// The distribution and its seed.
        settings: WorkloadSettings,
        /// Sizes of the maps, each at least 1.
        places: Vec<u32>,
        /// Observations in the sampling set, at least 1.
        samples: u32,
        /// Queries from new places, and as many revisits.
        queries: u32,
    },
    /// Read from the files of the numpy generator: one map.
    Files(PathBuf),
}

/// A map to be asked, each place seen once.
struct Trial<'a> {
    places: &'a [Observation],
    queries: Vec<Query>,
}

/// What one query came to by one method.
#[derive(Clone, Copy, Debug)]
struct Answer {
    /// Where the query was made; `None` for a new place.
    truth: Option<u32>,
    best_place: u32,
    posterior: f64,
    new_place_ms: f64,
    filter_ms: f64,
}

/// Every method on maps of growing size.
///
/// # Errors
/// [`EvalError`] if the workload cannot be had, or the results cannot be written.
pub fn run(options: &NewPlaceOptions) -> Result<NewPlaceReport, EvalError> {
    // Times are those of one thread.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let maps = match &options.source {
        WorkloadSource::Drawn { settings, places, samples, queries } => {
            let workload = Workload::new(*settings)?;
            let training = workload.images(Use::Training, *samples);
            let largest = workload.images(Use::Place, places.iter().copied().max().unwrap_or(0));
            let trials = places.iter().map(|&count| {
                let places = &largest[..count as usize];
                Trial { places, queries: queries_of(&workload, places, *queries) }
            });
            one_thread.install(|| measure_all(workload.tree(), &training, trials, options.threshold))?
        }
        WorkloadSource::Files(folder) => {
            let WorkloadFiles { tree, places, training, queries } = WorkloadFiles::open(folder)?;
            let trial = Trial { places: &places, queries };
            one_thread.install(|| measure_all(&tree, &training, std::iter::once(trial), options.threshold))?
        }
    };
    let report = NewPlaceReport::new(options, maps);
    report.write(options)?;
    Ok(report)
}

fn queries_of(workload: &Workload, places: &[Observation], count: u32) -> Vec<Query> {
    let revisits = (0..count).map(|index| {
        let revisit = workload.revisit(index, places);
        Query { place: Some(revisit.place), observation: revisit.observation }
    });
    let new = workload.images(Use::NewQuery, count).into_iter();
    revisits.chain(new.map(|observation| Query { place: None, observation })).collect()
}

fn measure_all<'a>(
    tree: &ChowLiuTree,
    training: &[Observation],
    trials: impl Iterator<Item = Trial<'a>>,
    threshold: f64,
) -> Result<Vec<MapSizeReport>, EvalError> {
    let model = Arc::new(ObservationModel::new(tree, DetectorModel::default(), Dependence::ChowLiu));
    let methods = NEW_PLACE_METHODS
        .iter()
        .map(|&(_, method)| NewPlace::new(method, &model, training))
        .collect::<Result<Vec<_>, _>>()?;
    trials.map(|trial| measure(&model, &methods, &trial, threshold)).collect()
}

/// The steps of [`fabmap::recognizer::Recognizer::recognize`], each on the watch; no motion, so that
/// every query stands alone.
fn measure(
    model: &Arc<ObservationModel>,
    methods: &[NewPlace],
    trial: &Trial<'_>,
    threshold: f64,
) -> Result<MapSizeReport, EvalError> {
    let mut index = InvertedIndex::new(model.clone());
    for place in trial.places {
        index.add(&Appearance::of(place));
    }
    let filter = PlaceFilter::new(FilterSettings::default()).map_err(EvalError::Filter)?;
    let mut answers = vec![Vec::with_capacity(trial.queries.len()); methods.len()];
    let mut likelihood_ms = Vec::with_capacity(trial.queries.len());
    let (mut weights, mut samples) = (QueryWeights::default(), SampleWorkspace::default());
    let (mut log_likelihoods, mut posterior) = (Vec::new(), PlaceDistribution::default());
    let bar = progress::bar("queries", trial.queries.len());
    for query in bar.wrap_iter(trial.queries.iter()) {
        let begun = Instant::now();
        let informative = model.informative_words(&query.observation);
        index.log_likelihoods_into(&informative, &mut weights, &mut log_likelihoods);
        likelihood_ms.push(milliseconds(begun));
        for (method, answers) in methods.iter().zip(&mut answers) {
            let begun = Instant::now();
            let new_place = method.term(&informative, log_likelihoods.len(), &mut samples);
            let new_place_ms = milliseconds(begun);
            let begun = Instant::now();
            let prior = filter.prior(&MotionPrior::even(), log_likelihoods.len());
            filter.update_into(&log_likelihoods, &new_place, &prior, &mut posterior);
            let filter_ms = milliseconds(begun);
            let (best_place, probability) = posterior.best_place().unwrap_or_default();
            let truth = query.place;
            answers.push(Answer { truth, best_place, posterior: probability, new_place_ms, filter_ms });
        }
    }
    bar.finish_and_clear();
    Ok(MapSizeReport::new(trial.places.len(), likelihood_ms, methods, &answers, threshold))
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
