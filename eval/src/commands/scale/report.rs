//! What the measurement of a growing map leaves behind.

use std::fmt::Write;
use std::path::Path;

use anyhow::Result;
use serde::Serialize;

use super::bail_out::BailOutReport;
use super::mistakes::MistakesReport;
use crate::files;
use crate::plots::growth_svg;
use crate::timing::{StageTimes, median, quantile};

/// The measures of one run; those without a size are of the whole map.
#[derive(Serialize)]
pub(crate) struct ScaleReport {
    /// Places on the map.
    pub places: usize,
    /// Words of the vocabulary.
    pub words: usize,
    /// Threads that queries ran on.
    pub threads: u16,
    /// Median time from a query's words to the normalised posterior and its top ten, in milliseconds.
    pub filter_update_ms_p50: f64,
    /// The same, of the slowest twentieth.
    pub filter_update_ms_p95: f64,
    /// Median time of the likelihoods of all places, in milliseconds.
    pub likelihood_ms_p50: f64,
    /// Median time of the new-place term, in milliseconds.
    pub new_place_ms_p50: f64,
    /// Median time to add a place, in microseconds.
    pub add_place_us_p50: f64,
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
    pub filter_update_ms_p50: f64,
    pub filter_update_ms_p95: f64,
    pub likelihood_ms_p50: f64,
    pub new_place_ms_p50: f64,
}

/// What was measured.
pub(super) struct Measures {
    pub(super) words: usize,
    pub(super) threads: u16,
    /// The last is of the whole map.
    pub(super) growth: Vec<GrowthPoint>,
    pub(super) adding_us: Vec<f64>,
    pub(super) updating_us: Vec<f64>,
    pub(super) postings: u64,
    pub(super) index_bytes: usize,
    pub(super) checkpoint_bytes: usize,
    pub(super) rss_mib: Option<f64>,
    pub(super) open_ms: f64,
}

const SUMMARY: &str = "scale.json";
const PLOT: &str = "scale.svg";

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

impl ScaleReport {
    pub(super) fn new(measures: Measures) -> Self {
        let Measures { words, threads, growth, adding_us, updating_us, postings, .. } = measures;
        let per_posting = |bytes: usize| bytes as f64 / postings.max(1) as f64;
        let whole = growth.last().cloned().unwrap_or_else(|| GrowthPoint::new(0, &[]));
        Self {
            places: whole.places,
            words,
            threads,
            filter_update_ms_p50: whole.filter_update_ms_p50,
            filter_update_ms_p95: whole.filter_update_ms_p95,
            likelihood_ms_p50: whole.likelihood_ms_p50,
            new_place_ms_p50: whole.new_place_ms_p50,
            add_place_us_p50: median(adding_us).unwrap_or(0.0),
            update_place_us_p50: median(updating_us).unwrap_or(0.0),
            postings,
            bytes_per_posting: per_posting(measures.index_bytes),
            checkpoint_bytes_per_posting: per_posting(measures.checkpoint_bytes),
            rss_mib: measures.rss_mib,
            open_ms: measures.open_ms,
            bail_out: None,
            mistakes: None,
            growth,
        }
    }

    /// The table to stderr; table and plot to the folder for the results, if there is one.
    pub(super) fn write(&self, out: Option<&Path>) -> Result<()> {
        eprint!("{}", self.table());
        let Some(out) = out else { return Ok(()) };
        files::create_folder(out)?;
        files::write_json(&out.join(SUMMARY), self)?;
        let line: Vec<(usize, f64)> =
            self.growth.iter().map(|point| (point.places, point.filter_update_ms_p50)).collect();
        files::write(&out.join(PLOT), growth_svg(&line)?.as_bytes())?;
        eprintln!("results: {} ({SUMMARY}, {PLOT})", out.display());
        Ok(())
    }

    fn table(&self) -> String {
        let mut table = "  places  update ms     p95  likelihood  new place\n".to_owned();
        for point in &self.growth {
            let _ = writeln!(
                table,
                "{:8}  {:9.3}  {:6.3}  {:10.3}  {:9.3}",
                point.places,
                point.filter_update_ms_p50,
                point.filter_update_ms_p95,
                point.likelihood_ms_p50,
                point.new_place_ms_p50,
            );
        }
        let _ = writeln!(
            table,
            "add {:.1} us, look {:.1} us; {:.2} bytes a posting, {:.2} in a checkpoint, opened in {:.0} ms",
            self.add_place_us_p50,
            self.update_place_us_p50,
            self.bytes_per_posting,
            self.checkpoint_bytes_per_posting,
            self.open_ms,
        );
        if let Some(bail_out) = &self.bail_out {
            let _ = writeln!(
                table,
                "bail-out: {:.2} % of the terms, {:.2} ms instead of {:.2} ms, {:.3} % of the decisions changed",
                100.0 * bail_out.bail_out_terms_fraction,
                bail_out.bail_out_ms_p50,
                bail_out.dense_ms_p50,
                100.0 * bail_out.bail_out_changed_fraction,
            );
        }
        if let Some(mistakes) = &self.mistakes {
            let _ = writeln!(
                table,
                "accepted {} of {} new places; {} of {} revisits, {} at another place; calibration error {:.3}",
                mistakes.false_accepts,
                mistakes.new_queries,
                mistakes.revisits_accepted,
                mistakes.revisit_queries,
                mistakes.revisits_misplaced,
                mistakes.ece.unwrap_or(0.0),
            );
        }
        table
    }
}
