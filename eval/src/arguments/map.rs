//! `waypost-eval map`.

use std::path::PathBuf;

use clap::Args;
use topomap::map::MAX_PAST_FRAMES;
use topomap::mapper::MapperSettings;
use topomap::verification::VerificationMethod;
use waypost_eval::choices::{VERIFICATION_METHODS, name_of};
use waypost_eval::commands::map::kitti::{self, KittiOptions};
use waypost_eval::commands::map::training::MapTraining;
use waypost_eval::commands::map::{self, MapOptions, ModelSource, WheelChoice};
use waypost_eval::error::EvalError;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::{Feature, FeatureSettings};

use crate::arguments::values::{choice, features, worlds};
use crate::print_if;

/// Drive a simulated robot along a route, map it in process and hold the map against the truth.
///
/// Each trial is another world, other wheels and other noise. Times are those of one thread. With --out, writes map.json
/// and for each trial map-SEED.svg: raw odometry, corrected map and truth over the floor plan.
#[derive(Args)]
pub(crate) struct MapArguments {
    /// The world.
    #[arg(long, default_value = NamedWorld::Office.name(), value_parser = worlds())]
    world: NamedWorld,
    /// One of its routes.
    #[arg(long, value_name = "NAME", required_unless_present = "kitti")]
    route: Option<String>,
    /// In place of a simulated world, a drive of known poses without images: a folder with poses.txt and loops.csv. Its
    /// true loops stand in for recognition, simulated wheels for its odometry; the map layer works alone.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["route", "world", "trials", "model", "out", "prior_frames",
          "verification", "feature", "words", "training_drives", "model_out"])]
    kitti: Option<PathBuf>,
    /// Seed of the first trial; the next ones take the next seeds.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Drives.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// The model file; without it, a model is trained on drives in other worlds.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["feature", "words", "training_drives", "model_out"])]
    model: Option<PathBuf>,
    /// The local feature that words are made of.
    #[arg(long, default_value = Feature::Orb.name(), value_parser = features())]
    feature: Feature,
    /// Number of words.
    #[arg(long, value_name = "N", default_value_t = MapTraining::default().words)]
    words: u32,
    /// Drives that the model is trained on.
    #[arg(long, value_name = "N", default_value_t = MapTraining::default().drives,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    training_drives: u32,
    /// File for the trained model.
    #[arg(long, value_name = "FILE")]
    model_out: Option<PathBuf>,
    /// Of the wheels: measured way = (1 + X) true way [default: drawn for each trial, within 0.05].
    #[arg(long, value_name = "X", requires = "drift_rad_per_m", allow_hyphen_values = true)]
    scale_error: Option<f64>,
    /// Of the wheels: turn that they see where there is none [default: drawn for each trial, within 3 degrees].
    #[arg(long, value_name = "RAD", requires = "scale_error", allow_hyphen_values = true)]
    drift_rad_per_m: Option<f64>,
    /// Frames that the prior looks back on.
    #[arg(long, value_name = "FRAMES", default_value_t = MAX_PAST_FRAMES as u32,
          value_parser = clap::value_parser!(u32).range(1..=MAX_PAST_FRAMES as i64))]
    prior_frames: u32,
    #[arg(long = "verify", value_parser = choice(VERIFICATION_METHODS), help = "Geometry that has to agree",
          default_value = name_of(VERIFICATION_METHODS, &MapperSettings::default().verification.method))]
    verification: VerificationMethod,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl MapArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { world, route, kitti, seed, trials, prior_frames, verification, out, json, .. } = self;
        let wheels = match (self.scale_error, self.drift_rad_per_m) {
            (Some(scale), Some(drift_rad_per_m)) => WheelChoice::Biased { scale, drift_rad_per_m },
            (Some(_) | None, Some(_) | None) => WheelChoice::Drawn,
        };
        if let Some(folder) = kitti {
            return print_if(json, &kitti::run(&KittiOptions { folder, seed, wheels })?);
        }
        let route = route.unwrap_or_default();
        let default = MapTraining::default().features;
        let features = FeatureSettings::new(self.feature, default.max_features(), default.image_width())
            .map_err(EvalError::FeatureSettings)?;
        let training = MapTraining { features, words: self.words, drives: self.training_drives };
        let model = self.model.map_or(ModelSource::Drives(training, self.model_out), ModelSource::File);
        let prior_frames = prior_frames as usize;
        let mut settings = MapperSettings { prior_frames, ..MapperSettings::default() };
        settings.verification.method = verification;
        print_if(json, &map::run(&MapOptions { world, route, seed, trials, model, wheels, settings, out })?)
    }
}
