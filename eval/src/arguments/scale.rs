//! `waypost-eval scale`.

use std::path::PathBuf;

use clap::Args;
use fabmap::new_place::NewPlaceMethod;
use fabmap::recognizer::RecognizerSettings;
use waypost_eval::choices::{NEW_PLACE_METHODS, name_of};
use waypost_eval::commands::scale::{self, Compared, ScaleOptions, ScaleSource};
use waypost_eval::error::EvalError;
use waypost_eval::workload::WorkloadSettings;

use crate::arguments::values::choice;
use crate::print_if;

/// Grow a synthetic map and measure what a filter update, a new place and a look cost, and what the index takes.
///
/// A filter update is everything from a query's words to the normalised posterior and its top ten. With --out,
/// writes scale.json and scale.svg.
#[derive(Args)]
pub(crate) struct ScaleArguments {
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
    /// Take tree, places, samples and queries from the files of the numpy generator instead.
    #[arg(long, value_name = "DIR",
          conflicts_with_all = ["places", "words", "most_looks", "samples", "queries", "seed"])]
    workload: Option<PathBuf>,
    /// How places nobody has seen are stood in for.
    #[arg(long, value_parser = choice(NEW_PLACE_METHODS),
          default_value = name_of(NEW_PLACE_METHODS, &RecognizerSettings::default().new_place))]
    new_place: NewPlaceMethod,
    /// Compare the dense scorer with places dropped early and without; takes a byte for each word of each place.
    #[arg(long)]
    bail_out: bool,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl ScaleArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { places, words, threads, most_looks, samples, queries, seed, workload, .. } = self;
        let settings = WorkloadSettings { words, seed, ..WorkloadSettings::default() };
        let drawn = ScaleSource::Drawn { settings, places, most_looks, samples, queries };
        let source = workload.map_or(drawn, ScaleSource::Files);
        let (threads, new_place, out) = (usize::from(threads), self.new_place, self.out);
        let compared = if self.bail_out { Compared::BailOut } else { Compared::Nothing };
        print_if(self.json, &scale::run(&ScaleOptions { source, threads, new_place, compared, out })?)
    }
}
