//! `waypost-eval visits`.

use std::path::PathBuf;

use clap::Args;
use waypost_eval::commands::visits::{self, VisitsOptions};
use waypost_eval::error::EvalError;

use crate::arguments::system::KnobArguments;
use crate::print_if;

/// Learn one or two visits of the same places, and query with the later ones: does recognition get better?
///
/// Every choice of earlier visits is tried, and all visits from the third on count alike.
#[derive(Args)]
pub(crate) struct VisitsArguments {
    /// Folder with images/ and loops.csv: the same places in the same order, visit after visit.
    #[arg(long, value_name = "DIR")]
    sequence: PathBuf,
    /// Places of a visit.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    places: u32,
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    #[command(flatten)]
    knobs: KnobArguments,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl VisitsArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { sequence, places, model, knobs, json } = self;
        let knobs = knobs.with_threshold(None);
        print_if(json, &visits::run(&VisitsOptions { sequence, places: places as usize, model, knobs })?)
    }
}
