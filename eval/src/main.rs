//! `waypost-eval`: how good is it? Models trained and sequences run in process, simulated robots driven, and a server put
//! under load.
//!
//! [`commands`] has one file per command, whose options are what the command line takes; each is a story told by its
//! function `run`. A [`dataset`] is streamed once, in order, through a [`ranking`]; its proposals are judged against the
//! truth and swept into [`precision_recall`].

mod calibration;
mod choices;
mod commands;
mod dataset;
mod error;
mod event_log;
mod false_pictures;
mod files;
mod match_matrix;
mod memory;
mod observing;
mod plots;
mod precision_recall;
mod progress;
mod ranking;
mod report;
mod timing;
mod vocabularies;
mod weights;
mod workload;

use std::io::{self, Write};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use serde_json::to_string;

use commands::{
    appearance, leave_one_out, load, map, merge, navigate, posegraph, recorded, scale, sequence, soak, train,
};
use error::Refused;

/// Measures Waypost: trains models, runs sequences in process and judges what is recognised, puts a server
/// under load.
///
/// Tables and progress go to stderr. Exit codes: 0 done, 1 failed, 2 wrong arguments.
#[derive(Parser)]
#[command(name = "waypost-eval", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print one JSON object on stdout.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Command {
    Train(train::TrainOptions),
    Sequence(Box<sequence::SequenceOptions>),
    LeaveOneOut(leave_one_out::LeaveOneOutOptions),
    Scale(scale::ScaleOptions),
    Load(load::LoadOptions),
    Posegraph(posegraph::PoseGraphOptions),
    Map(Box<map::MapOptions>),
    Navigate(navigate::NavigateOptions),
    Appearance(appearance::AppearanceOptions),
    Merge(Box<merge::MergeOptions>),
    Recorded(recorded::RecordedOptions),
    Soak(soak::SoakOptions),
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(if error.is::<Refused>() { 2 } else { 1 })
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let mut verdict = Ok(());
    let report = match &cli.command {
        Command::Train(options) => to_string(&train::run(options)?),
        Command::Sequence(options) => to_string(&sequence::run(options)?),
        Command::LeaveOneOut(options) => to_string(&leave_one_out::run(options)?),
        Command::Scale(options) => to_string(&scale::run(options)?),
        Command::Load(options) => to_string(&load::run(options)?),
        Command::Posegraph(options) => to_string(&posegraph::run(options)?),
        Command::Map(options) => to_string(&map::run(options)?),
        Command::Navigate(options) => to_string(&navigate::run(options)?),
        Command::Appearance(options) => to_string(&appearance::run(options)?),
        Command::Merge(options) => to_string(&merge::run(options)?),
        Command::Recorded(options) => to_string(&recorded::run(options)?),
        Command::Soak(options) => {
            let report = soak::run(options)?;
            verdict = report.verdict();
            to_string(&report)
        }
    }?;
    eprint!("{}", report::for_people(&report)?);
    if cli.json {
        writeln!(io::stdout().lock(), "{report}").context("stdout cannot be written")?;
    }
    verdict
}
