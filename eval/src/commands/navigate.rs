//! `waypost-eval navigate`: a simulated robot is taught a way and led along it again, and held against the truth.

mod guide;
mod judgement;
mod picture;
mod repeat;
mod teaching;

use std::path::PathBuf;

use fabmap::model::Model;
use rayon::prelude::*;
use topomap::navigation::NavigationSettings;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::Extractor;

use self::judgement::{NavigateReport, NavigateRun};
use self::repeat::{Drive, Vision};
use super::map::MapError;
use super::map::training::{FIRST_TRAINING_SEED, MapTraining, train};
use crate::error::EvalError;
use crate::{files, progress};

/// What to try, and under which conditions.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigateOptions {
    /// What the robot is to do.
    pub trial: Trial,
    /// Trials; their seeds are those from `seed` on.
    pub trials: u32,
    /// Of the first trial: of the world's looks, the wheels of both drives, the camera's noise and the link.
    pub seed: u64,
    /// The world.
    pub world: NamedWorld,
    /// One of its routes; the shortcut has one of its own.
    pub route: String,
    /// What lies between robot and server.
    pub conditions: Conditions,
    /// How the robot is led.
    pub settings: NavigationSettings,
    /// A model file; without it, a model is trained on drives in other worlds.
    pub model: Option<PathBuf>,
    /// Folder for pictures and the report.
    pub out: Option<PathBuf>,
}

/// What the robot is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trial {
    /// Drive the way again that it was taught.
    #[default]
    Repeat,
    /// Go to the end of a way with a detour in it, without the detour.
    Shortcut,
    /// Drive again, on images every 40 cm, what was taught with images every 5 cm.
    Sparse,
    /// Be carried off on the way, put down elsewhere on it, and find out.
    Kidnapped,
    /// Drive the way again, and look some other way at its end.
    Facing,
}

/// What lies between robot and server.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Share of frames that are lost, in [0, 1].
    pub drop: f64,
    /// Least time that each message is on its way, in seconds.
    pub delay_s: f64,
    /// What comes to that at random, at most, in seconds.
    pub jitter_s: f64,
    /// For how long nothing is seen, once on the way, in seconds.
    pub blind_s: f64,
    /// People beside the way: they come and stand before the robot, and go again.
    pub people: u32,
    /// Light of the day on which the way is driven again.
    pub lighting: Lighting,
}

/// Light of a day.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lighting {
    /// As when the way was taught.
    #[default]
    AsTaught,
    /// Drawn: within 30 % as bright, other lamps, from elsewhere.
    Another,
}

/// Drives and judges.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &NavigateOptions) -> Result<NavigateReport, EvalError> {
    let last = options.seed.saturating_add(u64::from(options.trials));
    if last > FIRST_TRAINING_SEED {
        return Err(MapError::SeedOfTraining.into());
    }
    let (model, extractor) = match &options.model {
        Some(path) => files::read_model(path)?,
        None => {
            let training = MapTraining::default();
            (train(&training)?, Extractor::new(training.features))
        }
    };
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let bar = progress::bar("trials", options.trials as usize);
    let seeds: Vec<u64> = (options.seed..last).collect();
    let runs = seeds.into_par_iter().map(|seed| {
        let run = trial(options, seed, (&model, extractor));
        bar.inc(1);
        run
    });
    let runs: Vec<NavigateRun> = runs.collect::<Result<_, EvalError>>()?;
    bar.finish_and_clear();
    let report = judgement::report(options, runs);
    if let Some(out) = &options.out {
        files::write(&out.join("navigate.json"), &serde_json::to_vec_pretty(&report).unwrap_or_default())?;
    }
    eprint!("{}", report.table());
    Ok(report)
}

/// Teaches a way, and drives it with a camera and without.
fn trial(
    options: &NavigateOptions,
    seed: u64,
    (model, extractor): (&Model, Extractor),
) -> Result<NavigateRun, EvalError> {
    let taught = teaching::teach(options, seed, (model, extractor))?;
    let seen = repeat::repeat(options, seed, &taught, (model, extractor), Vision::All)?;
    let by_wheels: Option<Drive> = match options.trial {
        Trial::Kidnapped => None,
        Trial::Repeat | Trial::Shortcut | Trial::Sparse | Trial::Facing => {
            Some(repeat::repeat(options, seed, &taught, (model, extractor), Vision::OnlyBeforeStarting)?)
        }
    };
    if let Some(out) = &options.out {
        let picture = picture::svg(&taught, &seen, by_wheels.as_ref());
        files::write(&out.join(format!("navigate-{seed}.svg")), picture.as_bytes())?;
    }
    Ok(NavigateRun::of(seed, options, &taught, &seen, by_wheels.as_ref()))
}
