//! `waypost-eval`: the command line of the evaluation.

mod arguments;

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use serde::Serialize;
use waypost_eval::error::EvalError;

use arguments::appearance::AppearanceArguments;
use arguments::calibrate::CalibrateArguments;
use arguments::compare::CompareArguments;
use arguments::load::LoadArguments;
use arguments::map::MapArguments;
use arguments::merge::MergeArguments;
use arguments::navigate::NavigateArguments;
use arguments::new_place::NewPlaceArguments;
use arguments::posegraph::PosegraphArguments;
use arguments::scale::ScaleArguments;
use arguments::sequence::SequenceArguments;
use arguments::train::TrainArguments;
use arguments::train_scale::TrainScaleArguments;
use arguments::visits::VisitsArguments;

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Train(arguments) => arguments.run(),
        Command::Calibrate(arguments) => arguments.run(),
        Command::Sequence(arguments) => arguments.run(),
        Command::NewPlace(arguments) => arguments.run(),
        Command::Scale(arguments) => arguments.run(),
        Command::Compare(arguments) => arguments.run(),
        Command::Visits(arguments) => arguments.run(),
        Command::Load(arguments) => arguments.run(),
        Command::TrainScale(arguments) => arguments.run(),
        Command::Posegraph(arguments) => arguments.run(),
        Command::Map(arguments) => arguments.run(),
        Command::Navigate(arguments) => arguments.run(),
        Command::Appearance(arguments) => arguments.run(),
        Command::Merge(arguments) => arguments.run(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Measures Waypost: trains models, runs sequences in process and judges what is recognised, puts a server
/// under load.
///
/// Tables and progress go to stderr. Exit codes: 0 done, 1 failed, 2 wrong arguments.
#[derive(Parser)]
#[command(name = "waypost-eval", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Train(TrainArguments),
    Calibrate(CalibrateArguments),
    Sequence(Box<SequenceArguments>),
    Compare(CompareArguments),
    Visits(Box<VisitsArguments>),
    NewPlace(NewPlaceArguments),
    Scale(ScaleArguments),
    Load(LoadArguments),
    TrainScale(TrainScaleArguments),
    Posegraph(PosegraphArguments),
    Map(Box<MapArguments>),
    Navigate(NavigateArguments),
    Appearance(AppearanceArguments),
    Merge(Box<MergeArguments>),
}

/// The one object on stdout.
fn print_if(json: bool, report: &impl Serialize) -> Result<(), EvalError> {
    if !json {
        return Ok(());
    }
    let not_printed = |reason: io::Error| EvalError::Write { path: PathBuf::from("stdout"), reason };
    let mut stdout = io::stdout().lock();
    serde_json::to_writer(&mut stdout, report).map_err(|error| not_printed(error.into()))?;
    writeln!(stdout).map_err(not_printed)
}

/// Ends the program as it ends where clap finds arguments that cannot be together.
fn refuse(message: &str) -> ! {
    Cli::command().error(ErrorKind::ArgumentConflict, message).exit()
}
