//! `waypost-eval navigate`.

use std::path::PathBuf;

use clap::Args;
use topomap::navigation::NavigationSettings;
use waypost_eval::choices::{LIGHTINGS, NAVIGATION_TRIALS, name_of};
use waypost_eval::commands::navigate::{self, Conditions, Lighting, NavigateOptions, Trial};
use waypost_eval::error::EvalError;
use waypost_sim::worlds::NamedWorld;

use crate::arguments::values::{choice, worlds};
use crate::print_if;

/// Teach a simulated robot a way, lead it along that way again by camera and wheels, and hold it against the truth.
///
/// Wheels are drawn anew for teaching and for repeating: within 5 % of scale and 3 degrees a metre of drift. The robot
/// drives 0.4 m/s and sends two images a second.
#[derive(Args)]
pub(crate) struct NavigateArguments {
    /// Trials, with the seeds from --seed on.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// Seed of the first trial.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// What the robot is to do: drive the way again; go to its end without the detour in it; drive on images every 40 cm
    /// what was taught every 5 cm; be carried off and find out; drive the way again and look some other way at its end.
    #[arg(long, value_parser = choice(NAVIGATION_TRIALS), default_value = name_of(NAVIGATION_TRIALS, &Trial::default()))]
    trial: Trial,
    /// The world.
    #[arg(long, default_value = NamedWorld::Office.name(), value_parser = worlds())]
    world: NamedWorld,
    /// One of its routes.
    #[arg(long, value_name = "NAME", default_value = "teach")]
    route: String,
    /// Share of frames that are lost.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = lost_share)]
    drop: f64,
    /// Least time that frames, odometry and commands are on their way, each, in seconds.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = seconds)]
    delay: f64,
    /// What comes to that at random, at most, in seconds.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = seconds)]
    jitter: f64,
    /// How long no image is sent, once on the way, in seconds.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = seconds)]
    blind: f64,
    /// People beside the way, who come and stand before the robot for a while.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=20))]
    people: u32,
    /// The light in which the way is driven again.
    #[arg(long, value_parser = choice(LIGHTINGS), default_value = name_of(LIGHTINGS, &Lighting::default()))]
    light: Lighting,
    /// The model file; without it, a model is trained on drives in other worlds.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl NavigateArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self {
            trials,
            seed,
            trial,
            world,
            route,
            drop,
            delay,
            jitter,
            blind,
            people,
            light,
            model,
            out,
            json,
        } = self;
        let conditions =
            Conditions { drop, delay_s: delay, jitter_s: jitter, blind_s: blind, people, lighting: light };
        let settings = NavigationSettings::default();
        let options = NavigateOptions { trial, trials, seed, world, route, conditions, settings, model, out };
        print_if(json, &navigate::run(&options)?)
    }
}

fn lost_share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        Ok(_) | Err(_) => Err("not a share from 0 to 1".to_owned()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=3600.0).contains(&seconds) => Ok(seconds),
        Ok(_) | Err(_) => Err("not a time from 0 to 3600 seconds".to_owned()),
    }
}
