//! Arguments of `waypost-eval merge`.

use std::path::PathBuf;

use topomap::mapper::MapperSettings;
use topomap::merging::MergeSettings;
use waypost_eval::choices::Choices;
use waypost_eval::commands::map::training::MapTraining;
use waypost_eval::commands::map::{ModelSource, WheelChoice};
use waypost_eval::commands::merge::kitti::{self, KittiMergeOptions};
use waypost_eval::commands::merge::large::{self, LargeOptions};
use waypost_eval::commands::merge::passes::{self, PassesOptions};
use waypost_eval::commands::merge::{self, MergeOptions, MergeScenario};
use waypost_eval::error::EvalError;

use crate::arguments::values::{choice, with_default};
use crate::print_if;

/// Makes one map of several, and holds it against the truth.
///
/// Drives are simulated, mapped, each in a frame of its own, and merged as far as they overlap. Wheels have a scale error
/// of 1 % and a drift of 0.2 degrees a metre unless said.
#[derive(clap::Args)]
pub(crate) struct MergeArguments {
    /// What is merged: a drive cut into two to four sessions; five robots in one building; or a drive in each of two
    /// buildings with the same offices in another arrangement, of which nothing may merge.
    #[arg(long, value_parser = choice(SCENARIOS), default_value = "sessions")]
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
    #[arg(long, value_name = "N", default_value_t = 2, requires = "large", value_parser = threads)]
    threads: usize,
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
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

const SCENARIOS: Choices<MergeScenario> = MergeScenario::ALL;

fn threads(text: &str) -> Result<usize, String> {
    let threads: usize = text.parse().map_err(|_| "it must be a number".to_owned())?;
    if (1..=1024).contains(&threads) { Ok(threads) } else { Err("it must be 1 to 1024".to_owned()) }
}

fn share(text: &str) -> Result<f64, String> {
    let share: f64 = text.parse().map_err(|_| "it must be a number".to_owned())?;
    if (0.0..1.0).contains(&share) { Ok(share) } else { Err("it must be at least 0 and below 1".to_owned()) }
}

impl MergeArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { scenario, route, seed, trials, scale_error: scale, drift_rad_per_m, out, json, .. } = self;
        let default = MergeSettings::default();
        let merge = MergeSettings { min_support: self.min_support.unwrap_or(default.min_support), ..default };
        let (wheels, false_share) = (WheelChoice::Biased { scale, drift_rad_per_m }, self.false_matches);
        if let Some(places) = self.large {
            let options = LargeOptions { places, threads: self.threads, seed, merge };
            return print_if(json, &large::run(&options)?);
        }
        if let (Some(folder), Some(model)) = (&self.passes, &self.model) {
            let options = PassesOptions { folder: folder.clone(), model: model.clone(), seed, merge };
            return print_if(json, &passes::run(&options)?);
        }
        if let Some(folder) = self.kitti {
            let merge = MergeSettings { min_total_evidence: 0.0, ..merge };
            let options = KittiMergeOptions { folder, seed, trials, wheels, false_share, merge };
            return print_if(json, &kitti::run(&options)?);
        }
        let options = MergeOptions {
            scenario,
            route,
            seed,
            trials,
            model: self.model.map_or(ModelSource::Drives(MapTraining::default(), None), ModelSource::File),
            wheels,
            settings: MapperSettings::default(),
            merge,
            false_share,
            out,
        };
        print_if(json, &merge::run(&options)?)
    }
}
