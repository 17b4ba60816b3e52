//! `waypost-eval compare`: several configurations over several sequences, in one table and one plot.

mod file;
mod tables;

pub use file::{CompareFile, ConfigurationEntry, SequenceEntry};

use std::path::PathBuf;

use serde::Serialize;

use super::sequence::{self, SequenceOptions, SequenceReport, System};
use crate::error::EvalError;
use crate::files;
use crate::plots::{self, Panel};
use crate::precision_recall::PrecisionRecall;

/// What to compare, on what.
#[derive(Clone, Debug, PartialEq)]
pub struct CompareOptions {
    /// The systems, each with its name, in the order of the table.
    pub configurations: Vec<Configuration>,
    /// The sequences, in the order of the table.
    pub sequences: Vec<SequenceEntry>,
    /// Folder for the results: the table, the plot, and a folder for every run.
    pub out: PathBuf,
}

/// A system with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Configuration {
    /// What tables and plot call it.
    pub name: String,
    /// Folder that the sequences' models are taken from.
    pub models: PathBuf,
    /// The system.
    pub system: System,
}

/// All runs, configuration by configuration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompareReport {
    /// One row a run.
    pub runs: Vec<ComparedRun>,
}

/// One configuration on one sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedRun {
    /// The configuration's name.
    pub configuration: String,
    /// The sequence's name.
    pub sequence: String,
    /// What was measured.
    #[serde(flatten)]
    pub report: SequenceReport,
}

/// Runs everything, one run after the other so that times can be compared, and writes `compare.md`,
/// `compare.csv`, `compare.json`, `compare.svg`, and what `sequence` writes for every run.
///
/// # Errors
/// [`EvalError`]; runs that ended before keep their files.
pub fn run(options: &CompareOptions) -> Result<CompareReport, EvalError> {
    let mut runs = Vec::new();
    let mut curves = Vec::new();
    for (number, configuration) in options.configurations.iter().enumerate() {
        for entry in &options.sequences {
            let run = SequenceOptions {
                sequence: entry.path.clone(),
                gap: entry.gap,
                model: configuration.models.join(&entry.model),
                system: configuration.system.clone(),
                seed: 0,
                out: options.out.join(format!("{number}-{}", entry.name)),
            };
            eprintln!("--- {} on {}", configuration.name, entry.name);
            let (report, curve) = sequence::run_with_curve(&run)?;
            let (configuration, sequence) = (configuration.name.clone(), entry.name.clone());
            runs.push(ComparedRun { configuration, sequence, report });
            curves.push(curve);
        }
    }
    let report = CompareReport { runs };
    write_all(&report, &curves, options)?;
    Ok(report)
}

fn write_all(
    report: &CompareReport,
    curves: &[PrecisionRecall],
    options: &CompareOptions,
) -> Result<(), EvalError> {
    let path = |name: &str| options.out.join(name);
    let not_written = |name: &str, reason: std::io::Error| EvalError::Write { path: path(name), reason };
    let markdown = tables::markdown(&report.runs);
    files::write(&path("compare.md"), markdown.as_bytes())?;
    let rows = tables::csv(&report.runs).map_err(|reason| not_written("compare.csv", reason.into()))?;
    files::write(&path("compare.csv"), &rows)?;
    let mut json =
        serde_json::to_vec_pretty(report).map_err(|reason| not_written("compare.json", reason.into()))?;
    json.push(b'\n');
    files::write(&path("compare.json"), &json)?;

    let panels: Vec<Panel<'_>> =
        options.sequences.iter().map(|entry| panel(&entry.name, report, curves)).collect();
    let svg = plots::compared_curves_svg(&panels)
        .map_err(|reason| EvalError::Plot { path: path("compare.svg"), reason })?;
    files::write(&path("compare.svg"), svg.as_bytes())?;
    eprint!("\n{markdown}\n");
    eprintln!("results in {} (compare.md, .csv, .json, .svg)", options.out.display());
    Ok(())
}

/// The curves of one sequence.
fn panel<'a>(sequence: &'a str, report: &'a CompareReport, curves: &'a [PrecisionRecall]) -> Panel<'a> {
    let of_sequence = report.runs.iter().zip(curves).filter(|(run, _)| run.sequence == sequence);
    Panel {
        title: sequence,
        curves: of_sequence.map(|(run, curve)| (run.configuration.as_str(), curve)).collect(),
    }
}
