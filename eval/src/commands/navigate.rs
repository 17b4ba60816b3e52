//! `waypost-eval navigate`: a simulated robot is taught a way and led along it again, and held against the truth.

mod guide;
mod judgement;
mod picture;
mod repeat;
mod teaching;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};
use fabmap::model::Model;
use rayon::prelude::*;
use serde::Serialize;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::Extractor;

use self::judgement::{NavigateReport, NavigateRun};
use self::repeat::{Drive, StuckReport, StuckRun, Vision};
use super::map::training::{check_seeds, model_or_default};
use crate::choices::{number, worlds};
use crate::{files, progress};

/// Teach a simulated robot a way, lead it along that way again by camera and wheels, and hold it against the truth.
///
/// Wheels are drawn for teaching and again for repeating: within 5 % of scale and 3 degrees a metre of drift. The robot
/// drives 0.4 m/s and sends two images a second.
#[derive(Args)]
pub(crate) struct NavigateOptions {
    /// Trials, with the seeds from --seed on.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// Seed of the first trial.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// What the robot is to do: drive the way again; go to its end without the detour in it; drive on images every 40 cm
    /// what was taught every 5 cm; be carried off and find out; drive the way again and look some other way at its
    /// end; be held by something on the way.
    #[arg(long, value_enum, default_value_t)]
    trial: Trial,
    /// The world.
    #[arg(long, default_value = NamedWorld::Office.name(), value_parser = worlds())]
    world: NamedWorld,
    /// One of its routes; the shortcut has one of its own.
    #[arg(long, value_name = "NAME", default_value = "teach")]
    route: String,
    #[command(flatten)]
    conditions: Conditions,
    /// The model file; without it, a model is trained on drives in other worlds.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// What the robot is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Trial {
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
    /// Be held by something on the way: wheels that stand, that slip before what was taught, and before a bare wall.
    Stuck,
}

/// What lies between robot and server.
#[derive(Args)]
struct Conditions {
    /// Share of frames that are lost.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = number(0.0..=1.0))]
    drop: f64,
    /// Least time that frames, odometry and commands are on their way, each, in seconds.
    #[arg(long = "delay", value_name = "S", default_value_t = 0.0, value_parser = number(0.0..=3600.0))]
    delay_s: f64,
    /// What comes to that at random, at most, in seconds.
    #[arg(long = "jitter", value_name = "S", default_value_t = 0.0, value_parser = number(0.0..=3600.0))]
    jitter_s: f64,
    /// How long no image is sent, once on the way, in seconds.
    #[arg(long = "blind", value_name = "S", default_value_t = 0.0, value_parser = number(0.0..=3600.0))]
    blind_s: f64,
    /// People beside the way, who come and stand before the robot for a while.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=20))]
    people: u32,
    /// The light in which the way is driven again.
    #[arg(long = "light", value_enum, default_value_t)]
    lighting: Lighting,
}

/// Light of a day.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Lighting {
    /// As when the way was taught.
    #[default]
    AsTaught,
    /// Drawn: within 30 % as bright, other lamps, from elsewhere.
    Another,
}

/// Drives and judges.
pub(crate) fn run(options: &NavigateOptions) -> Result<Outcome> {
    check_seeds(options.seed, options.trials)?;
    let (model, extractor) = model_or_default(options.model.as_deref())?;
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let bar = progress::bar("trials", options.trials as usize);
    let seeds: Vec<u64> = (options.seed..).take(options.trials as usize).collect();
    if options.trial == Trial::Stuck {
        let report = stuck(options, &seeds, (&model, extractor))?;
        bar.finish_and_clear();
        return Ok(Outcome::Stuck(report));
    }
    let runs = seeds.into_par_iter().map(|seed| {
        let run = trial(options, seed, (&model, extractor));
        bar.inc(1);
        run
    });
    let runs: Vec<NavigateRun> = runs.collect::<Result<_>>()?;
    bar.finish_and_clear();
    let report = judgement::report(options, runs);
    if let Some(out) = &options.out {
        files::write_json(&out.join("navigate.json"), &report)?;
    }
    Ok(Outcome::Drives(Box::new(report)))
}

/// What came out.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum Outcome {
    Drives(Box<NavigateReport>),
    Stuck(StuckReport),
}

/// Holds robots on their way.
fn stuck(
    options: &NavigateOptions,
    seeds: &[u64],
    (model, extractor): (&Model, Extractor),
) -> Result<StuckReport> {
    let runs = seeds.par_iter().map(|&seed| {
        let taught = teaching::teach(options, seed, (model, extractor))?;
        repeat::stuck(options, seed, &taught, (model, extractor))
    });
    let runs: Vec<Vec<StuckRun>> = runs.collect::<Result<_>>()?;
    let report = StuckReport::of(runs.into_iter().flatten().collect());
    if let Some(out) = &options.out {
        files::write_json(&out.join("stuck.json"), &report)?;
    }
    Ok(report)
}

/// Teaches a way, and drives it with a camera and without.
fn trial(
    options: &NavigateOptions,
    seed: u64,
    (model, extractor): (&Model, Extractor),
) -> Result<NavigateRun> {
    let taught = teaching::teach(options, seed, (model, extractor))?;
    let seen = repeat::repeat(options, seed, &taught, (model, extractor), Vision::All)?;
    let by_wheels: Option<Drive> = match options.trial {
        Trial::Kidnapped | Trial::Stuck => None,
        Trial::Repeat | Trial::Shortcut | Trial::Sparse | Trial::Facing => {
            Some(repeat::repeat(options, seed, &taught, (model, extractor), Vision::OnlyBeforeStarting)?)
        }
    };
    if let Some(out) = &options.out {
        let picture = picture::svg(&taught, &seen, by_wheels.as_ref());
        files::write(&out.join(format!("navigate-{seed}.svg")), picture.as_bytes())?;
    }
    Ok(NavigateRun::of(seed, &taught, &seen, by_wheels.as_ref()))
}
