//! `waypost-eval merge`: drives become maps, maps become one, and that is held against the truth.

mod kitti;
mod large;
mod passes;
mod picture;
mod report;
mod sessions;
mod trial;
mod world;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde::Serialize;
use topomap::merging::MergeSettings;

use self::large::LargeReport;
use self::passes::PassesReport;
use self::report::MergeReport;
use super::map::WheelChoice;
use super::map::training::model_or_default;
use crate::choices::{own_name, with_default};
use crate::{files, progress};

/// Makes one map of several, and holds it against the truth.
///
/// Drives are simulated, mapped, each in a frame of its own, and merged as far as they overlap. Wheels have a scale error
/// of 1 % and a drift of 0.2 degrees a metre unless said.
#[derive(Args)]
pub(crate) struct MergeOptions {
    /// What is merged: a drive cut into two to four sessions; five robots in one building; or a drive in each of two
    /// buildings with the same offices in another arrangement, of which nothing may merge.
    #[arg(long, value_enum, default_value_t)]
    scenario: MergeScenario,
    /// In place of a simulated world, a drive of known poses without images, cut into two to four sessions: a folder with
    /// poses.txt and loops.csv. Its true loops stand in for recognition.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scenario", "route", "model", "out"])]
    kitti: Option<PathBuf>,
    /// In place of a simulated world, real images without odometry, of a building that was walked through twice: a folder
    /// with images and an index.csv that says of each frame its pass, 1 or 2, and its floor. The passes are merged, and then
    /// every floor of the one with every floor of the other.
    #[arg(long, value_name = "DIR", requires = "model", conflicts_with_all = ["scenario", "kitti", "route", "trials", "false_matches", "out"])]
    passes: Option<PathBuf>,
    /// In place of a simulated world, two maps of so many places each, drawn at random and seen in words alone; half of
    /// their places are the same. How long it takes is measured.
    #[arg(long, value_name = "N", conflicts_with_all = ["scenario", "kitti", "passes", "route", "trials", "model", "false_matches", "out"],
        value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    large: Option<u32>,
    /// Threads that the large maps are merged on.
    #[arg(long, value_name = "N", default_value_t = 2, requires = "large",
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// The route of the sessions, in the office.
    #[arg(long, value_name = "NAME", default_value = "98m")]
    route: String,
    /// Seed of the first trial; the next ones take the next seeds.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Trials.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// The model file; without it, a model is trained on drives in other worlds.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Of the wheels: measured way = (1 + X) true way.
    #[arg(long, value_name = "X", default_value_t = 0.01, allow_hyphen_values = true)]
    scale_error: f64,
    /// Of the wheels: turn that they see where there is none.
    #[arg(long, value_name = "RAD", default_value_t = 0.2_f64.to_radians(), allow_hyphen_values = true)]
    drift_rad_per_m: f64,
    /// Matches that are made up, as a share of all, below 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    false_matches: f64,
    #[arg(long, value_name = "MATCHES", help = with_default(
        "Least matches that agree with each other",
        MergeSettings::default().min_support,
    ))]
    min_support: Option<usize>,
    /// Folder for the pictures; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// What is merged.
#[derive(Clone, Copy, Default, ValueEnum)]
enum MergeScenario {
    /// A drive, cut into two to four sessions.
    #[default]
    Sessions,
    /// Five robots in one building.
    Robots,
    /// A drive in each of two buildings with the same offices in another arrangement: nothing may merge.
    LookAlike,
}

/// What came out.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum MergeOutcome {
    Drives(MergeReport),
    Passes(PassesReport),
    Large(LargeReport),
}

/// Stages, maps, merges, and judges.
pub(crate) fn run(options: &MergeOptions) -> Result<MergeOutcome> {
    if let Some(places) = options.large {
        return Ok(MergeOutcome::Large(large::run(places, options)?));
    }
    if let (Some(folder), Some(model)) = (&options.passes, &options.model) {
        return Ok(MergeOutcome::Passes(passes::run(folder, model, options)?));
    }
    if let Some(folder) = &options.kitti {
        return Ok(MergeOutcome::Drives(kitti::run(folder, options)?));
    }
    let (model, extractor) = model_or_default(options.model.as_deref())?;
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let bar = progress::bar("trials", options.trials as usize);
    let mut runs = Vec::new();
    for seed in (options.seed..).take(options.trials as usize) {
        runs.push(trial::run(options, seed, &model, extractor)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(MergeOutcome::Drives(MergeReport::of(own_name(&options.scenario), options, runs)))
}

impl MergeOptions {
    /// What a merge has to show.
    fn merge(&self) -> MergeSettings {
        let default = MergeSettings::default();
        MergeSettings { min_support: self.min_support.unwrap_or(default.min_support), ..default }
    }

    fn wheels(&self) -> WheelChoice {
        WheelChoice::Biased { scale: self.scale_error, drift_rad_per_m: self.drift_rad_per_m }
    }
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if (0.0..1.0).contains(&share) => Ok(share),
        Ok(_) | Err(_) => Err("it must be at least 0 and below 1".to_owned()),
    }
}
