//! `waypost-eval calibrate`.

use std::path::PathBuf;

use clap::Args;
use waypost_eval::choices::{DETECTORS, name_of};
use waypost_eval::commands::calibrate::{self, CalibrateOptions, DetectorChoice};
use waypost_eval::error::EvalError;

use crate::arguments::values::choice;
use crate::print_if;

/// Learn anew how reliable a model's words are, from the training images that it remembers.
///
/// Words stay the same, so that maps can be bound to the new model.
#[derive(Args)]
pub(crate) struct CalibrateArguments {
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// As for `train`.
    #[arg(long, value_parser = choice(DETECTORS), default_value = name_of(DETECTORS, &DetectorChoice::Learned))]
    detector: DetectorChoice,
    /// The model file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl CalibrateArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { model, detector, out, json } = self;
        print_if(json, &calibrate::run(&CalibrateOptions { model, detector, out })?)
    }
}
