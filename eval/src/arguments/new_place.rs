//! `waypost-eval new-place`.

use std::path::PathBuf;

use clap::Args;
use waypost_eval::commands::new_place::{self, NewPlaceOptions, WorkloadSource};
use waypost_eval::error::EvalError;
use waypost_eval::workload::WorkloadSettings;

use crate::print_if;

/// Ask synthetic maps of growing size about places they have and places they do not, and count how often
/// each new-place method takes one for the other.
///
/// With --out, writes new_place.json and new_place.svg.
#[derive(Args)]
pub(crate) struct NewPlaceArguments {
    /// Sizes of the maps.
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [100, 1_000, 10_000],
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    places: Vec<u32>,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "V", default_value_t = WorkloadSettings::default().words,
          value_parser = clap::value_parser!(u32).range(1..))]
    words: u32,
    /// Observations in the sampling set.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Queries from new places, and as many revisits.
    #[arg(long, value_name = "N", default_value_t = 2_000, value_parser = clap::value_parser!(u32).range(1..))]
    queries: u32,
    /// Seed of tree, places and queries.
    #[arg(long, value_name = "S", default_value_t = WorkloadSettings::default().seed)]
    seed: u64,
    /// Take tree, places, samples and queries from the files of the numpy generator instead.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["places", "words", "samples", "queries", "seed"])]
    workload: Option<PathBuf>,
    /// Posterior from which the most probable place counts as accepted.
    #[arg(long, value_name = "P", default_value_t = 0.5)]
    threshold: f64,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl NewPlaceArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { places, words, samples, queries, seed, workload, threshold, out, json } = self;
        let settings = WorkloadSettings { words, seed, ..WorkloadSettings::default() };
        let drawn = WorkloadSource::Drawn { settings, places, samples, queries };
        let source = workload.map_or(drawn, WorkloadSource::Files);
        print_if(json, &new_place::run(&NewPlaceOptions { source, threshold, out })?)
    }
}
