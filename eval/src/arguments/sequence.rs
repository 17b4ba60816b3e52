//! `waypost-eval sequence`.

use std::path::PathBuf;

use clap::Args;
use waypost_eval::commands::sequence::{self, SequenceOptions};
use waypost_eval::error::EvalError;

use crate::arguments::system::SystemArguments;
use crate::{print_if, refuse};

/// Stream a sequence with known loops once, in order, and judge the earlier frame proposed for each.
///
/// Writes precision_recall.csv and .svg, reliability.svg, match_matrix.png, frames.csv and summary.json.
#[derive(Args)]
pub(crate) struct SequenceArguments {
    /// Folder with images/, loops.csv and optionally ignore.csv (query_index,match_index).
    #[arg(long, value_name = "DIR")]
    sequence: PathBuf,
    /// Frames closer than this many are not loops.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..))]
    gap: u32,
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of the random choices, which the verification makes.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    system: SystemArguments,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl SequenceArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { sequence, gap, model, out, seed, system, json } = self;
        let system = system.system().unwrap_or_else(|message| refuse(message));
        let gap = gap as usize;
        let report = sequence::run(&SequenceOptions { sequence, gap, model, system, seed, out })?;
        print_if(json, &report)
    }
}
