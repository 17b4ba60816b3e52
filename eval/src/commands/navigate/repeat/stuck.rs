//! Robots that something holds on their way, and how soon they are stopped.

use anyhow::Result;
use fabmap::model::Model;
use serde::Serialize;
use waypost_navigation::metric::Status;
use waypost_sim::drive::IMAGE_SIZE_PX;
use waypost_sim::simulation::HeldWheels;
use waypost_vision::GreyImage;
use waypost_vision::features::Extractor;

use super::{Course, Vision, name};
use crate::commands::navigate::NavigateOptions;
use crate::commands::navigate::teaching::Taught;
use crate::timing::quantile;

/// How a robot is held, and what it sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Case {
    /// Its wheels stand: a wall, an obstacle that the map does not have.
    WheelsStand,
    /// They slip, and it sees what it was taught.
    SlipsBeforeTexture,
    /// They slip, and it sees a bare wall.
    SlipsBeforeBareWall,
}

impl Case {
    const ALL: [Self; 3] = [Self::WheelsStand, Self::SlipsBeforeTexture, Self::SlipsBeforeBareWall];

    fn wheels(self) -> HeldWheels {
        match self {
            Self::WheelsStand => HeldWheels::Stand,
            Self::SlipsBeforeTexture | Self::SlipsBeforeBareWall => HeldWheels::Slip,
        }
    }

    /// Within what time it has to be stopped, in seconds.
    fn limit_s(self) -> f64 {
        match self {
            Self::WheelsStand => 2.0,
            Self::SlipsBeforeTexture => 6.0,
            Self::SlipsBeforeBareWall => 10.0,
        }
    }

    /// Whether it is to be lost: there is nothing to tell it where it is.
    fn is_to_be_lost(self) -> bool {
        match self {
            Self::SlipsBeforeBareWall => true,
            Self::WheelsStand | Self::SlipsBeforeTexture => false,
        }
    }
}

/// A robot that was held.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct StuckRun {
    pub seed: u64,
    pub case: Case,
    /// Whether it was on its way until then; those that were not are not counted.
    pub held: bool,
    /// Seconds until it was told to stand and stood, by the robot's clock.
    pub stopped_s: Option<f64>,
    /// As what it was told of then.
    pub status: Option<&'static str>,
    /// Whether it went back later on.
    pub backed_off: bool,
}

/// What came of one case.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct StuckCase {
    pub case: Case,
    pub held: usize,
    /// Those that were stopped in time.
    pub in_time: usize,
    pub stopped_s_median: f64,
    pub stopped_s_max: f64,
    pub backed_off: usize,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct StuckReport {
    pub cases: Vec<StuckCase>,
    pub runs: Vec<StuckRun>,
}

/// How long a held robot is watched, in seconds.
const WATCHED_S: f64 = 20.0;

/// Of a bare wall, of 255.
const BARE: u8 = 150;

/// A wall without anything on it, close before the camera.
pub(super) fn bare_wall() -> Result<GreyImage> {
    let (width_px, height_px) = IMAGE_SIZE_PX;
    Ok(GreyImage::new(width_px, height_px, vec![BARE; (width_px * height_px) as usize])?)
}

/// Drives once for each case.
pub(in crate::commands::navigate) fn stuck(
    options: &NavigateOptions,
    seed: u64,
    taught: &Taught,
    model: (&Model, Extractor),
) -> Result<Vec<StuckRun>> {
    Case::ALL.into_iter().map(|case| run(options, seed, taught, model, case)).collect()
}

fn run(
    options: &NavigateOptions,
    seed: u64,
    taught: &Taught,
    model: (&Model, Extractor),
    case: Case,
) -> Result<StuckRun> {
    let mut course = Course::new(options, seed, taught, model, Vision::All)?;
    let mut run = StuckRun { seed, case, held: false, stopped_s: None, status: None, backed_off: false };
    let mut way_m = 0.0;
    let mut last = course.simulation.robot().pose().position();
    while !(way_m >= course.kidnapped_at_m && course.status == Status::Following) {
        let tick = course.step()?;
        way_m += (tick.truth.position() - last).norm();
        last = tick.truth.position();
        if course.status == Status::Arrived || tick.stamp_ns as f64 * 1e-9 > 300.0 {
            return Ok(run);
        }
    }
    run.held = true;
    course.simulation.hold_back(case.wheels());
    course.sees_bare_wall = case == Case::SlipsBeforeBareWall;
    let held_ns = course.simulation.now_ns();
    loop {
        let tick = course.step()?;
        let elapsed_s = (tick.stamp_ns - held_ns) as f64 * 1e-9;
        let [forward_m_s, _] = course.simulation.robot().speed();
        let stopped = match (course.status, case.is_to_be_lost()) {
            (Status::Lost, _) | (Status::Blocked, false) => true,
            (Status::Blocked, true)
            | (Status::Idle | Status::Following | Status::Searching | Status::Arrived, _) => false,
        };
        if stopped && course.told_m_s == 0.0 && forward_m_s.abs() < 1e-3 && run.stopped_s.is_none() {
            (run.stopped_s, run.status) = (Some(elapsed_s), Some(name(course.status)));
        }
        run.backed_off |= run.stopped_s.is_some() && forward_m_s < -0.05;
        if elapsed_s >= WATCHED_S {
            return Ok(run);
        }
    }
}

impl StuckReport {
    pub(in crate::commands::navigate) fn of(runs: Vec<StuckRun>) -> Self {
        let cases = Case::ALL.map(|case| {
            let held = || runs.iter().filter(|run| run.case == case && run.held);
            let seconds: Vec<f64> = held().filter_map(|run| run.stopped_s).collect();
            StuckCase {
                case,
                held: held().count(),
                in_time: seconds.iter().filter(|seconds| **seconds <= case.limit_s()).count(),
                stopped_s_median: quantile(seconds.clone(), 0.5).unwrap_or(f64::NAN),
                stopped_s_max: quantile(seconds, 1.0).unwrap_or(f64::NAN),
                backed_off: held().filter(|run| run.backed_off).count(),
            }
        });
        Self { cases: cases.to_vec(), runs }
    }
}
