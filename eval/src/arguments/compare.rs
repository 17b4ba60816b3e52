//! `waypost-eval compare`.

use std::path::PathBuf;

use clap::{Args, Parser};
use waypost_eval::commands::compare::{self, CompareFile, CompareOptions, Configuration, ConfigurationEntry};
use waypost_eval::error::EvalError;

use crate::arguments::system::SystemArguments;
use crate::print_if;

/// Run several configurations over several sequences, and write one table and one plot.
///
/// Writes compare.md, compare.csv, compare.json and compare.svg (precision over recall, a panel for every
/// sequence), and beside them a folder for every run as `sequence` writes it.
///
/// The file has a table for every sequence and for every configuration; relative paths are taken from the
/// file's own folder:
///
///     [[sequence]]
///     path = "data/hall"                  # images/, loops.csv; its name is the folder's, or name = "..."
///     gap = 30                            # as for `sequence`
///     model = "indoor.waypost"            # within the configuration's folder of models
///
///     [[configuration]]
///     name = "default"
///
///     [[configuration]]
///     name = "tf-idf"
///     flags = "--ranking tf-idf"          # what `sequence` would be given
///     models = "other-models"             # folder of the models, if it is another
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub(crate) struct CompareArguments {
    /// The TOML file that says what to compare.
    #[arg(value_name = "FILE")]
    comparison: PathBuf,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// The flags of a configuration in the file of a comparison.
#[derive(Parser)]
#[command(name = "flags", no_binary_name = true, disable_help_flag = true)]
struct ConfigurationFlags {
    #[command(flatten)]
    system: SystemArguments,
}

impl CompareArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { comparison: path, out, json } = self;
        let CompareFile { sequences, configurations } = CompareFile::read(&path)?;
        let configuration = |entry: ConfigurationEntry| {
            let ConfigurationEntry { name, flags, models } = entry;
            let refused = |reason: String| EvalError::Comparison {
                path: path.clone(),
                reason: format!("the flags of configuration {name:?}: {reason}"),
            };
            let flags = ConfigurationFlags::try_parse_from(flags.split_whitespace())
                .map_err(|error| refused(error.to_string()))?;
            let system = flags.system.system().map_err(|message| refused(message.to_owned()))?;
            Ok(Configuration { name, models, system })
        };
        let configurations =
            configurations.into_iter().map(configuration).collect::<Result<_, EvalError>>()?;
        print_if(json, &compare::run(&CompareOptions { configurations, sequences, out })?)
    }
}
