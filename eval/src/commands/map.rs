//! `waypost-eval map`: a simulated robot drives a route and maps it, and its map is held against the truth.

pub mod alignment;
pub mod drive;
pub mod judgement;
pub mod kitti;
pub mod mapping;
mod picture;
pub mod training;

use std::path::PathBuf;

use fabmap::model::Model;
use fabmap::vocabulary::VocabularyError;
use serde::Serialize;
use topomap::mapper::MapperSettings;
use topomap::odometry::OdometryError;
use waypost_sim::camera::CameraError;
use waypost_sim::people::PersonError;
use waypost_sim::range::OutOfRange;
use waypost_sim::robot::WheelErrors;
use waypost_sim::route::RouteError;
use waypost_sim::simulation::{DriveError, SimulationError};
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::features::{Extractor, FeatureError, FeatureSettings};
use waypost_vision::image::ImageError;

use self::drive::Drive;
use self::judgement::{CLOSURE_DEFINITIONS, Figures, MapTimes};
use self::mapping::Mapped;
use self::training::{FIRST_TRAINING_SEED, MapTraining};
use crate::error::EvalError;
use crate::timing::{MedianTimes, median};
use crate::{files, progress};

/// Where to drive, with what, and how often.
#[derive(Clone, Debug, PartialEq)]
pub struct MapOptions {
    /// The world.
    pub world: NamedWorld,
    /// One of its routes.
    pub route: String,
    /// Of the first drive; the next ones take the next seeds. It decides about the world's looks, the wheels and the
    /// camera's noise, and lies below [`FIRST_TRAINING_SEED`].
    pub seed: u64,
    /// Drives, at least 1.
    pub trials: u32,
    /// Where the model comes from.
    pub model: ModelSource,
    /// How wrong the wheels are.
    pub wheels: WheelChoice,
    /// How the map decides.
    pub settings: MapperSettings,
    /// Folder for the pictures.
    pub out: Option<PathBuf>,
}

/// Where the model comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum ModelSource {
    /// A file.
    File(PathBuf),
    /// Drives in other worlds of the kinds; what was learnt is kept in the file, if there is to be one.
    Drives(MapTraining, Option<PathBuf>),
}

/// How wrong the wheels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WheelChoice {
    /// Drawn anew for each drive: [`WheelErrors::drawn`].
    Drawn,
    /// The same for all.
    Biased {
        /// Measured way = (1 + scale) true way.
        scale: f64,
        /// Radians per metre.
        drift_rad_per_m: f64,
    },
}

/// What came out: medians over the drives, and the worst of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapReport {
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
    pub stages_ms_p50: MedianTimes,
    /// The largest of each figure over the drives.
    pub worst: Figures,
    /// Medians where the prior looks back on one frame alone.
    pub with_one_prior_frame: Figures,
    /// How the figures are defined.
    pub definitions: std::collections::BTreeMap<&'static str, &'static str>,
    /// Drive by drive.
    pub runs: Vec<MapRun>,
}

/// One drive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapRun {
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
}

/// Why a simulated robot could not map its world.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The world has other routes.
    #[error("{world} has no route {route}; there are {names}")]
    Route {
        /// The world.
        world: &'static str,
        /// The route asked for.
        route: String,
        /// Those it has.
        names: String,
    },
    /// Models are trained in the worlds of those seeds.
    #[error("seeds from {FIRST_TRAINING_SEED} on are those of the training drives; take lower ones")]
    SeedOfTraining,
    /// A number of the robot is out of its range.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// The camera cannot be.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// There is no room for a person.
    #[error(transparent)]
    Person(#[from] PersonError),
    /// The robot does not fit.
    #[error(transparent)]
    Blocked(#[from] RouteError),
    /// The robot cannot start.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// It did not arrive.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// An image is none.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// An image has no place for features.
    #[error(transparent)]
    Features(FeatureError),
    /// The model's words are of another feature than its extractor's.
    #[error("the model's vocabulary does not fit its own extractor ({0}); train it anew")]
    Vocabulary(VocabularyError),
    /// A line that is no pose.
    #[error("{path} line {line} is no pose; write 12 numbers, the rows of a 3 x 4 matrix")]
    Poses {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
    },
    /// The wheels said what no wheels say.
    #[error(transparent)]
    Odometry(OdometryError),
}

impl MapError {
    /// Exit code of the program: 2 if the command line asks for what cannot be, 1 for all else.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            MapError::Route { .. } | MapError::SeedOfTraining | MapError::OutOfRange(_) => 2,
            MapError::Camera(_)
            | MapError::Person(_)
            | MapError::Blocked(_)
            | MapError::Simulation(_)
            | MapError::Drive(_)
            | MapError::Image(_)
            | MapError::Features(_)
            | MapError::Vocabulary(_)
            | MapError::Poses { .. }
            | MapError::Odometry(_) => 1,
        }
    }
}

/// Drives and maps, and holds each map against its drive.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &MapOptions) -> Result<MapReport, EvalError> {
    if options.seed.saturating_add(u64::from(options.trials)) > FIRST_TRAINING_SEED {
        return Err(MapError::SeedOfTraining.into());
    }
    let route = named_route(options.world, &options.route)?;
    let (model, extractor) = model_of(&options.model)?;
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let one_frame = MapperSettings { prior_frames: 1, ..options.settings };
    let (mut trials, mut with_one) = (Vec::new(), Vec::new());
    let bar = progress::bar("drives", options.trials as usize);
    for seed in (options.seed..).take(options.trials as usize) {
        let wheels = options.wheels.errors(seed);
        let drive = drive::drive(options.world, &route, seed, wheels)?;
        let map = |settings| one_thread.install(|| mapping::map(&drive.frames, &model, extractor, settings));
        let mapped = map(options.settings)?;
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
        files::write(&out.join("map.json"), &serde_json::to_vec_pretty(&report).unwrap_or_default())?;
    }
    eprint!("{}", report.table());
    Ok(report)
}

/// A route of a world.
///
/// # Errors
/// [`MapError::Route`] if it has none of that name.
pub fn named_route(world: NamedWorld, route: &str) -> Result<NamedRoute, MapError> {
    world.route(route).ok_or_else(|| {
        let names: Vec<&str> = world.routes().iter().map(|route| route.name).collect();
        MapError::Route { world: world.name(), route: route.to_owned(), names: names.join(", ") }
    })
}

pub(crate) fn model_of(source: &ModelSource) -> Result<(Model, Extractor), EvalError> {
    match source {
        ModelSource::File(path) => files::read_model(path),
        ModelSource::Drives(training, out) => {
            let model = training::train(training)?;
            if let Some(out) = out {
                files::write(out, &model.to_bytes())?;
            }
            Ok((model, Extractor::new(training.features)))
        }
    }
}

impl WheelChoice {
    pub(crate) fn errors(self, seed: u64) -> WheelErrors {
        match self {
            WheelChoice::Drawn => WheelErrors::drawn(seed),
            WheelChoice::Biased { scale, drift_rad_per_m } => WheelErrors::biased(scale, drift_rad_per_m),
        }
    }
}

impl Default for MapTraining {
    fn default() -> Self {
        // 3,000 words of ORB: features that a small robot has time for.
        let features =
            FeatureSettings::new(waypost_vision::features::Feature::Orb, 500, drive::IMAGE_SIZE_PX.0);
        Self { features: features.unwrap_or_default(), words: 3_000, drives: 8 }
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
        }
    }
}

fn report(
    options: &MapOptions,
    (model, extractor): (&Model, Extractor),
    trials: &[(MapRun, f64, Mapped)],
    with_one: &[Figures],
) -> MapReport {
    let MapOptions { world, route, seed, trials: count, settings, .. } = options;
    let figures: Vec<Figures> = trials.iter().map(|(run, ..)| run.figures.clone()).collect();
    let times: Vec<_> = trials.iter().flat_map(|(.., mapped)| mapped.times.iter().copied()).collect();
    MapReport {
        world: world.name().to_owned(),
        route: route.clone(),
        seed: *seed,
        trials: *count,
        features: extractor.settings().to_string(),
        model_hash: model.hash().to_string(),
        prior_frames: settings.prior_frames,
        length_m: median(trials.iter().map(|(_, length_m, _)| *length_m).collect()).unwrap_or(0.0),
        median: Figures::combined(&figures, median),
        times: MapTimes::of(trials.iter().map(|(.., mapped)| mapped)),
        stages_ms_p50: MedianTimes::of(&times),
        worst: Figures::combined(&figures, |values| values.into_iter().reduce(f64::max)),
        with_one_prior_frame: Figures::combined(with_one, median),
        definitions: CLOSURE_DEFINITIONS.into(),
        runs: trials.iter().map(|(run, ..)| run.clone()).collect(),
    }
}

impl MapReport {
    fn table(&self) -> String {
        let percent = |fraction: f64| format!("{:.1} %", 100.0 * fraction);
        let (median, worst, times, one) =
            (&self.median, &self.worst, &self.times, &self.with_one_prior_frame);
        let mut table = format!(
            "{} {}, {} drives of {:.0} m, {:.0} images, {}\n\
             seed  revisits  missed  accepted  false  wheels m  map m  rigid m  scaled m  robot m  left out\n",
            self.world, self.route, self.trials, self.length_m, median.images, self.features,
        );
        let rows = self.runs.iter().map(|run| (run.seed.to_string(), &run.figures));
        for (name, figures) in rows.chain([("median".to_owned(), median), ("worst".to_owned(), worst)]) {
            table += &format!(
                "{name:<6}{:>8.0}{:>8}{:>10.0}{:>7.0}{:>10.2}{:>7.2}{:>9.2}{:>10.2}{:>9.2}{:>6.0} of {:.0}\n",
                figures.closures_true,
                percent(figures.missed_fraction),
                figures.closures_accepted,
                figures.closures_false,
                figures.odometry_rmse_m,
                figures.map_rmse_m,
                figures.map_rmse_rigid_m,
                figures.map_rmse_scaled_m,
                figures.robot_error_closed_m_median,
                figures.map_contradicted_links,
                figures.map_closure_links,
            );
        }
        let stages: Vec<String> = self
            .stages_ms_p50
            .stages()
            .into_iter()
            .filter_map(|(stage, time)| time.map(|time| format!("{stage} {time:.2}")))
            .collect();
        table
            + &format!(
                "closures are wrong by  {:.2} m, {:.1} degrees\n\
                 one frame in the prior missed {}, false {}\n\
                 ms per image           median {:.1}, 95 % within {:.1}; {}\n\
                 ms per relaxation      median {:.2}, 95 % within {:.2}, at most {:.2}\n",
                median.closure_position_error_m,
                median.closure_heading_error_deg,
                percent(one.missed_fraction),
                percent(one.false_fraction),
                times.ms_per_image_p50,
                times.ms_per_image_p95,
                stages.join(", "),
                times.relax_ms_p50,
                times.relax_ms_p95,
                times.relax_ms_max,
            )
    }
}
