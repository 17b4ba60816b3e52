//! `waypost-eval map`: a simulated robot drives a route and maps it, and its map is held against the truth.

pub(crate) mod alignment;
pub(crate) mod closures;
pub(crate) mod drive;
pub(crate) mod judgement;
pub(crate) mod kitti;
pub(crate) mod mapping;
mod picture;
pub(crate) mod training;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use fabmap::model::Model;
use serde::Serialize;
use topomap::evidence::VerificationMethod;
use topomap::settings::{MAX_PAST_FRAMES, MapperSettings};
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::features::{Extractor, Feature, FeatureSettings};

use self::closures::{ClosureCheck, MeasuredFigures};
use self::drive::Drive;
use self::judgement::{Figures, MapTimes};
use self::kitti::KittiReport;
use self::mapping::Mapped;
use self::training::{MapTraining, check_seeds};
use crate::choices::{VERIFICATION_METHODS, choice, features, name_of, worlds};
use crate::error::refused;
use crate::timing::{StageTimes, median};
use crate::{files, progress};

/// Drive a simulated robot along a route, map it in process and hold the map against the truth.
///
/// Each trial is another world, other wheels and other noise. Times are those of one thread. With --out, writes map.json
/// and for each trial map-SEED.svg: raw odometry, corrected map and truth over the floor plan.
#[derive(Args)]
pub(crate) struct MapOptions {
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
}

/// How wrong the wheels are.
#[derive(Clone, Copy)]
pub(crate) enum WheelChoice {
    /// Drawn for each drive: [`WheelErrors::drawn`].
    Drawn,
    /// The same for all.
    Biased {
        /// Measured way = (1 + scale) true way.
        scale: f64,
        /// Radians per metre.
        drift_rad_per_m: f64,
    },
}

/// What came out.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum MapOutcome {
    Drives(Box<MapReport>),
    Kitti(KittiReport),
}

/// What came out: medians over the drives, and the worst of them.
#[derive(Serialize)]
pub(crate) struct MapReport {
    /// Name of the world.
    pub world: String,
    /// Name of the route.
    pub route: String,
    /// Of the first drive.
    pub seed: u64,
    /// Drives.
    pub trials: u32,
    /// Features that words are made of.
    pub features: String,
    /// Hash of the model.
    pub model_hash: String,
    /// Frames that the prior looks back on.
    pub prior_frames: usize,
    /// Metres that the robot really drove, median.
    pub length_m: f64,
    /// Medians over the drives.
    #[serde(flatten)]
    pub median: Figures,
    /// Over all frames of all drives.
    #[serde(flatten)]
    pub times: MapTimes,
    /// Medians of the stages over all frames of all drives.
    pub stages_ms_p50: StageTimes,
    /// The largest of each figure over the drives.
    pub worst: Figures,
    /// How well closures measured, all drives together.
    pub measured: MeasuredFigures,
    /// Medians where the prior looks back on one frame alone.
    pub with_one_prior_frame: Figures,
    /// Drive by drive.
    pub runs: Vec<MapRun>,
}

/// One drive.
#[derive(Clone, Serialize)]
pub(crate) struct MapRun {
    /// Its seed.
    pub seed: u64,
    /// The wheels' scale error.
    pub scale_error: f64,
    /// The wheels' drift, in radians per metre.
    pub drift_rad_per_m: f64,
    /// How often the robot ran into something.
    pub collisions: u64,
    /// What came of it.
    #[serde(flatten)]
    pub figures: Figures,
    /// Closures that were accepted.
    pub closures: Vec<ClosureCheck>,
}

/// Drives and maps, and holds each map against its drive.
pub(crate) fn run(options: &MapOptions) -> Result<MapOutcome> {
    if let Some(folder) = &options.kitti {
        return Ok(MapOutcome::Kitti(kitti::run(folder, options.seed, options.wheels())?));
    }
    check_seeds(options.seed, options.trials)?;
    let route = named_route(options.world, options.route.as_deref().unwrap_or_default())?;
    let (model, extractor) = match &options.model {
        Some(path) => files::read_model(path)?,
        None => options.training()?.model(options.model_out.as_deref())?,
    };
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let settings = options.settings();
    let one_frame = MapperSettings { prior_frames: 1, ..settings };
    let mut trials = Vec::new();
    let mut with_one = Vec::new();
    let bar = progress::bar("drives", options.trials as usize);
    for seed in (options.seed..).take(options.trials as usize) {
        let wheels = options.wheels().errors(seed);
        let drive = drive::drive(options.world, &route, seed, wheels)?;
        let map = |settings| one_thread.install(|| mapping::map(&drive.frames, &model, extractor, settings));
        let mapped = map(settings)?;
        with_one.push(judgement::judge(&drive.frames, &map(one_frame)?));
        if let Some(out) = &options.out {
            files::write(&out.join(format!("map-{seed}.svg")), picture::svg(&drive, &mapped).as_bytes())?;
        }
        trials.push((MapRun::of(seed, wheels, &drive, &mapped), drive.recording.length_m(), mapped));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let report = report(options, (&model, extractor), &trials, &with_one);
    if let Some(out) = &options.out {
        files::write_json(&out.join("map.json"), &report)?;
    }
    Ok(MapOutcome::Drives(Box::new(report)))
}

impl MapOptions {
    fn wheels(&self) -> WheelChoice {
        match (self.scale_error, self.drift_rad_per_m) {
            (Some(scale), Some(drift_rad_per_m)) => WheelChoice::Biased { scale, drift_rad_per_m },
            (Some(_) | None, Some(_) | None) => WheelChoice::Drawn,
        }
    }

    fn settings(&self) -> MapperSettings {
        let mut settings =
            MapperSettings { prior_frames: self.prior_frames as usize, ..MapperSettings::default() };
        settings.verification.method = self.verification;
        settings
    }

    fn training(&self) -> Result<MapTraining> {
        let default = MapTraining::default().features;
        let features = FeatureSettings::new(self.feature, default.max_features(), default.image_width());
        Ok(MapTraining {
            features: features.map_err(refused)?,
            words: self.words,
            drives: self.training_drives,
        })
    }
}

/// A route of a world.
pub(crate) fn named_route(world: NamedWorld, route: &str) -> Result<NamedRoute> {
    world.route(route).ok_or_else(|| {
        let names: Vec<&str> = world.routes().iter().map(|route| route.name).collect();
        refused(format!("{} has no route {route}; there are {}", world.name(), names.join(", ")))
    })
}

impl WheelChoice {
    pub(crate) fn errors(self, seed: u64) -> WheelErrors {
        match self {
            WheelChoice::Drawn => WheelErrors::drawn(seed),
            WheelChoice::Biased { scale, drift_rad_per_m } => WheelErrors::biased(scale, drift_rad_per_m),
        }
    }
}

impl MapRun {
    fn of(seed: u64, wheels: WheelErrors, drive: &Drive, mapped: &Mapped) -> Self {
        Self {
            seed,
            scale_error: wheels.scale,
            drift_rad_per_m: wheels.drift_rad_per_m,
            collisions: drive.recording.collisions,
            figures: judgement::judge(&drive.frames, mapped),
            closures: closures::closures(&drive.frames, mapped),
        }
    }
}

fn report(
    options: &MapOptions,
    (model, extractor): (&Model, Extractor),
    trials: &[(MapRun, f64, Mapped)],
    with_one: &[Figures],
) -> MapReport {
    let figures: Vec<Figures> = trials.iter().map(|(run, ..)| run.figures.clone()).collect();
    let times: Vec<_> = trials.iter().flat_map(|(.., mapped)| mapped.times.iter().copied()).collect();
    MapReport {
        world: options.world.name().to_owned(),
        route: options.route.clone().unwrap_or_default(),
        seed: options.seed,
        trials: options.trials,
        features: extractor.settings().to_string(),
        model_hash: model.hash().to_string(),
        prior_frames: options.prior_frames as usize,
        length_m: median(trials.iter().map(|(_, length_m, _)| *length_m).collect()).unwrap_or(0.0),
        median: Figures::combined(&figures, median),
        times: MapTimes::of(trials.iter().map(|(.., mapped)| mapped)),
        stages_ms_p50: StageTimes::medians(&times),
        worst: Figures::combined(&figures, |values| values.into_iter().reduce(f64::max)),
        measured: MeasuredFigures::of(
            &trials.iter().flat_map(|(run, ..)| run.closures.iter().cloned()).collect::<Vec<_>>(),
        ),
        with_one_prior_frame: Figures::combined(with_one, median),
        runs: trials.iter().map(|(run, ..)| run.clone()).collect(),
    }
}
