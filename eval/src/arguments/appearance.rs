//! `waypost-eval appearance`.

use std::path::PathBuf;

use clap::Args;
use waypost_eval::commands::appearance::{self, AppearanceOptions, AppearanceReport};
use waypost_eval::error::EvalError;

/// Send a simulated robot with a panoramic camera to goals by looks alone, in buildings that it has images of.
#[derive(Args)]
pub(crate) struct AppearanceArguments {
    /// Buildings that the robot drives in, each with two goals.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// Seed of the first building; the next ones take the next seeds.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Folder for the pictures; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    pub(crate) json: bool,
}

impl AppearanceArguments {
    pub(crate) fn run(self) -> Result<AppearanceReport, EvalError> {
        let Self { trials, seed, out, json: _ } = self;
        appearance::run(&AppearanceOptions { trials, seed, out })
    }
}
