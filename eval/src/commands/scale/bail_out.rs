//! Places dropped early against every word of every place.

use std::time::Instant;

use fabmap::PlaceId;
use fabmap::baselines::{BailOutRisk, DenseScorer};
use fabmap::new_place::{NewPlace, SampleWorkspace};
use fabmap::observation::Observation;
use fabmap::place_filter::{MotionPrior, PlaceDistribution, PlaceFilter};
use rayon::prelude::*;
use serde::Serialize;

use crate::timing::{median, milliseconds};

/// What dropping places early saves, and what it costs.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct BailOutReport {
    /// Terms that were evaluated over those of all words and places: the mean over queries.
    pub bail_out_terms_fraction: f64,
    /// Median time of the dense scorer over the median time with bail-out.
    pub bail_out_speedup: f64,
    /// Queries decided otherwise than by all terms.
    pub bail_out_changed_fraction: f64,
    /// Median time with bail-out, in milliseconds.
    pub bail_out_ms_p50: f64,
    /// Median time of the dense scorer, in milliseconds.
    pub dense_ms_p50: f64,
    /// Queries that this was measured with.
    pub bail_out_queries: usize,
}

/// One query, both ways.
struct Comparison {
    dense_ms: f64,
    bail_out_ms: f64,
    terms: u64,
    changed: bool,
}

/// Every query stands alone: an even prior, and the decision that the filter's posterior makes.
pub(super) fn compare(
    scorer: &DenseScorer,
    new_place: &NewPlace,
    filter: &PlaceFilter,
    queries: &[Observation],
    threads: &rayon::ThreadPool,
) -> BailOutReport {
    let one = |query: &Observation| {
        let begun = Instant::now();
        let dense = scorer.log_likelihoods(query);
        let dense_ms = milliseconds(begun);
        let begun = Instant::now();
        let dropped = scorer.bail_out(query, BailOutRisk::default());
        let bail_out_ms = milliseconds(begun);
        let decision = |log_likelihoods: &[f64]| {
            let informative = scorer.model().informative_words(query);
            let term = new_place.term(&informative, scorer.places(), &mut SampleWorkspace::default());
            let prior = filter.prior(&MotionPrior::even(), scorer.places());
            decision(&filter.update(log_likelihoods, &term, &prior))
        };
        let changed = decision(&dense) != decision(&dropped.log_likelihoods);
        Comparison { dense_ms, bail_out_ms, terms: dropped.terms, changed }
    };
    let compared: Vec<Comparison> = threads.install(|| queries.par_iter().map(one).collect());
    let time = |of: fn(&Comparison) -> f64| median(compared.iter().map(of).collect()).unwrap_or(0.0);
    let dense_ms_p50 = time(|one| one.dense_ms);
    let bail_out_ms_p50 = time(|one| one.bail_out_ms);
    let all_terms = (scorer.model().vocabulary_len() * scorer.places() * compared.len()) as f64;
    let changed = compared.iter().filter(|one| one.changed).count();
    BailOutReport {
        bail_out_terms_fraction: compared.iter().map(|one| one.terms as f64).sum::<f64>() / all_terms,
        bail_out_speedup: dense_ms_p50 / bail_out_ms_p50,
        bail_out_changed_fraction: changed as f64 / compared.len().max(1) as f64,
        bail_out_ms_p50,
        dense_ms_p50,
        bail_out_queries: compared.len(),
    }
}

/// The place, or `None` for a new one.
fn decision(posterior: &PlaceDistribution) -> Option<PlaceId> {
    let best = posterior.best_place().filter(|&(_, probability)| probability >= posterior.new_place);
    best.map(|(place, _)| place)
}
