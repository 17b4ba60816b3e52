//! What the measurement of a growing map leaves behind.

use serde::Serialize;

use super::bail_out::BailOutReport;
use super::mistakes::MistakesReport;
use crate::timing::{StageTimes, quantile};

/// The measures of one run; those without a size are of the whole map.
#[derive(Serialize)]
pub(crate) struct ScaleReport {
    /// The whole map.
    #[serde(flatten)]
    pub whole: GrowthPoint,
    /// Words of the vocabulary.
    pub words: usize,
    /// Threads that queries ran on.
    pub threads: u16,
    /// Median time to add a place, in microseconds.
    pub add_place_us_p50: f64,
    /// Mean of the same: now and then a place is merged into its block with those before it, which medians do not show.
    pub add_place_us_mean: f64,
    /// Median time of one more look at a place, half of it words that the place did not have, in microseconds.
    pub update_place_us_p50: f64,
    /// (word, place) pairs in the index.
    pub postings: u64,
    /// Memory of the index with all that it knows of its places, over its postings.
    pub bytes_per_posting: f64,
    /// Bytes of the places' appearances in a checkpoint, over the postings.
    pub checkpoint_bytes_per_posting: f64,
    /// Resident memory of this process with the whole map, in MiB; null where the system does not tell.
    pub rss_mib: Option<f64>,
    /// Time to make the index from the places' appearances in a checkpoint, in milliseconds.
    pub open_ms: f64,
    /// The dense scorer with places dropped early, if that was asked for.
    #[serde(flatten)]
    pub bail_out: Option<BailOutReport>,
    /// How often a place is taken for another, if that was asked for.
    pub mistakes: Option<MistakesReport>,
    /// The map as it grew.
    pub growth: Vec<GrowthPoint>,
}

/// A map of one size.
#[derive(Clone, Serialize)]
pub(crate) struct GrowthPoint {
    /// Places on the map.
    pub places: usize,
    /// Median time from a query's words to the normalised posterior and its top ten, in milliseconds.
    pub filter_update_ms_p50: f64,
    /// The same, of the slowest twentieth.
    pub filter_update_ms_p95: f64,
    /// Median time of the likelihoods of all places, in milliseconds.
    pub likelihood_ms_p50: f64,
    /// Median time of the new-place term, in milliseconds.
    pub new_place_ms_p50: f64,
}

impl GrowthPoint {
    pub(super) fn new(places: usize, times: &[StageTimes]) -> Self {
        let medians = StageTimes::medians(times);
        let totals = times.iter().filter_map(|times| times.total).collect();
        Self {
            places,
            filter_update_ms_p50: medians.total.unwrap_or(0.0),
            filter_update_ms_p95: quantile(totals, 0.95).unwrap_or(0.0),
            likelihood_ms_p50: medians.likelihood.unwrap_or(0.0),
            new_place_ms_p50: medians.new_place.unwrap_or(0.0),
        }
    }
}
