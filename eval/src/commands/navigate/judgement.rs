//! Drives held against the way that was taught.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use posegraph::{PlanarPose, Pose as _};
use serde::Serialize;
use waypost_navigation::metric::{Seen, Status};

use super::repeat::{Drive, Kidnapping, name};
use super::teaching::Taught;
use super::{NavigateOptions, Trial};
use crate::commands::map::judgement::{FALSE_M, FALSE_RAD};
use crate::timing::{median, quantile};

/// What came out.
#[derive(Serialize)]
pub(crate) struct NavigateReport {
    /// What the robot was to do.
    pub trial: Trial,
    /// Drives.
    pub trials: usize,
    /// Those at whose end the robot said that it was there and was, within [`ARRIVED_M`].
    pub arrived: usize,
    /// From the true position to the true way that was taught, over all drives, at every 5 cm driven.
    pub cross_track_m_mean: f64,
    /// 95 % were nearer.
    pub cross_track_m_p95: f64,
    /// The largest.
    pub cross_track_m_max: f64,
    /// Drives that arrive by wheels alone, once told where they start.
    pub odometry_only_arrived: usize,
    /// Cross-track of these, mean.
    pub odometry_only_cross_track_m_mean: f64,
    /// Frames on the way at which a place was recognised, as a share of those that came to the server.
    pub closure_rate: f64,
    /// Those of them that were believed.
    pub believed_rate: f64,
    /// Closures that put the robot more than 1.5 m or 40 degrees from where it is.
    pub false_closures: usize,
    /// Those of them that were believed.
    pub false_believed: usize,
    /// Most frames in a row on the way without a place.
    pub unrecognised_run_max: usize,
    /// Times that a robot thought itself lost, after it had started.
    pub times_lost: u32,
    /// Collisions.
    pub collisions: u64,
    /// From where the robot ends to where the goal was taught, median, in metres.
    pub goal_error_m_median: f64,
    /// Of a drive, median, in metres.
    pub driven_m_median: f64,
    /// Of the way that was taught, median, in metres.
    pub taught_m_median: f64,
    /// Of the way that was planned, median, in metres.
    pub planned_m_median: f64,
    /// Robots that were carried off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kidnapped: Option<KidnappedReport>,
    /// Drive by drive.
    pub runs: Vec<NavigateRun>,
}

/// What came of carrying robots off.
#[derive(Serialize)]
pub(crate) struct KidnappedReport {
    /// Robots.
    pub kidnapped: usize,
    /// Those that found out where they were.
    pub relocalized: usize,
    /// Those that needed no more than one turn for it.
    pub relocalized_within_one_turn: usize,
    /// Those that believed to be elsewhere, be it for one frame.
    pub believed_elsewhere: usize,
    /// Seconds until they knew that something was wrong, median.
    pub noticed_s_median: f64,
    /// What they turned, median, in degrees.
    pub turned_deg_median: f64,
}

/// One drive.
#[derive(Serialize)]
pub(crate) struct NavigateRun {
    /// Its seed.
    pub seed: u64,
    /// Whether it arrived.
    pub arrived: bool,
    /// How far off it looked at the end, in degrees, if it was told where to look.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub facing_error_deg: Option<f64>,
    /// What the robot said at the end.
    pub status: &'static str,
    /// Mean.
    pub cross_track_m_mean: f64,
    /// 95 % were nearer.
    pub cross_track_m_p95: f64,
    /// The largest.
    pub cross_track_m_max: f64,
    /// From where it ends to where the goal was taught.
    pub goal_error_m: f64,
    /// Whether it would have arrived by wheels alone.
    pub odometry_only_arrived: Option<bool>,
    /// Where it would have ended.
    pub odometry_only_goal_error_m: Option<f64>,
    /// Frames that came to the server on the way.
    pub frames: usize,
    /// Those at which a place was recognised.
    pub closures: usize,
    /// Those that were believed.
    pub believed: usize,
    /// Those recognised falsely.
    pub false_closures: usize,
    /// Those believed falsely.
    pub false_believed: usize,
    /// Most frames in a row without a place.
    pub unrecognised_run: usize,
    /// Times lost after the start.
    pub times_lost: u32,
    /// Collisions.
    pub collisions: u64,
    /// Seconds in each status.
    pub seconds_in: BTreeMap<&'static str, f64>,
    /// Driven, taught and planned, in metres.
    pub driven_m: f64,
    pub taught_m: f64,
    pub planned_m: Option<f64>,
    /// Scale errors of the wheels that taught.
    pub taught_scale: f64,
    /// Drift of the wheels that taught, in rad/m.
    pub taught_drift_rad_per_m: f64,
    /// If it was carried off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kidnapping: Option<Kidnapping>,
    #[serde(skip)]
    cross_track_m: Vec<f64>,
    #[serde(skip)]
    odometry_only_cross_track_m: Vec<f64>,
}

/// How far from the goal a robot may end: a place's spacing.
const ARRIVED_M: f64 = 0.5;

/// How far off it may look there, if it was told where to look.
const FACING_RAD: f64 = 0.175;

const SAMPLE_M: f64 = 0.05;

impl NavigateRun {
    pub(super) fn of(seed: u64, taught: &Taught, seen: &Drive, by_wheels: Option<&Drive>) -> Self {
        let path = taught.path();
        let errors = cross_track(seen, &path);
        let wheel_errors = by_wheels.map_or_else(Vec::new, |drive| cross_track(drive, &path));
        let on_the_way: Vec<_> = seen.looks.iter().filter(|look| look.on_the_way).collect();
        let is_false = |apart: (f64, f64)| apart.0 > FALSE_M || apart.1 > FALSE_RAD;
        let is_believed = |seen: Seen| matches!(seen, Seen::Corrected | Seen::Found);
        let count = |wanted: &dyn Fn(&super::repeat::Looked) -> bool| {
            on_the_way.iter().filter(|look| wanted(look)).count()
        };
        let runs = on_the_way.split(|look| look.recognised.is_some());
        let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        Self {
            seed,
            arrived: arrived(seen, taught),
            facing_error_deg: facing_error_rad(seen, taught).map(f64::to_degrees),
            status: seen.status.map_or("none", name),
            cross_track_m_mean: mean(&errors),
            cross_track_m_p95: quantile(errors.clone(), 0.95).unwrap_or(0.0),
            cross_track_m_max: errors.iter().copied().fold(0.0, f64::max),
            goal_error_m: goal_error_m(seen, taught),
            odometry_only_arrived: by_wheels.map(|drive| arrived(drive, taught)),
            odometry_only_goal_error_m: by_wheels.map(|drive| goal_error_m(drive, taught)),
            frames: on_the_way.len(),
            closures: count(&|look| look.recognised.is_some()),
            believed: count(&|look| is_believed(look.seen)),
            false_closures: count(&|look| look.apart.is_some_and(is_false)),
            false_believed: count(&|look| is_believed(look.seen) && look.apart.is_some_and(is_false)),
            unrecognised_run: runs.map(<[_]>::len).max().unwrap_or(0),
            times_lost: seen.times_lost.saturating_sub(1),
            collisions: seen.collisions,
            seconds_in: seen.seconds_in.clone(),
            driven_m: seen.path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum(),
            taught_m: taught.length_m(),
            planned_m: seen.planned_m,
            taught_scale: taught.wheels.scale,
            taught_drift_rad_per_m: taught.wheels.drift_rad_per_m,
            kidnapping: seen.kidnapping,
            cross_track_m: errors,
            odometry_only_cross_track_m: wheel_errors,
        }
    }
}

fn arrived(drive: &Drive, taught: &Taught) -> bool {
    drive.status == Some(Status::Arrived)
        && goal_error_m(drive, taught) <= ARRIVED_M
        && facing_error_rad(drive, taught).is_none_or(|radians| radians <= FACING_RAD)
}

/// Of where the robot looks at the end, if it was told where to.
fn facing_error_rad(drive: &Drive, taught: &Taught) -> Option<f64> {
    let turned = PlanarPose::new(0.0, 0.0, drive.facing_rad?);
    let wanted = taught.truth_of_place(taught.goal)?.compose(&turned);
    let ends = PlanarPose::new(0.0, 0.0, drive.end_heading_rad);
    Some(PlanarPose::new(0.0, 0.0, wanted.heading_rad()).inverse().compose(&ends).heading_rad().abs())
}

fn goal_error_m(drive: &Drive, taught: &Taught) -> f64 {
    let [x_m, y_m] = drive.end;
    taught
        .truth_of_place(taught.goal)
        .map_or(f64::INFINITY, |goal| (goal.x_m() - x_m).hypot(goal.y_m() - y_m))
}

/// Distances to a line of points, at even distances along the drive.
fn cross_track(drive: &Drive, path: &[Vector2<f64>]) -> Vec<f64> {
    let mut errors = Vec::new();
    let mut way_m = SAMPLE_M;
    for pair in drive.path.windows(2) {
        way_m += (pair[1] - pair[0]).norm();
        if way_m >= SAMPLE_M {
            way_m -= SAMPLE_M;
            let distance = |point: &Vector2<f64>| (point - pair[1]).norm();
            errors.push(path.iter().map(distance).fold(f64::INFINITY, f64::min));
        }
    }
    errors
}

pub(super) fn report(options: &NavigateOptions, runs: Vec<NavigateRun>) -> NavigateReport {
    let errors: Vec<f64> = runs.iter().flat_map(|run| run.cross_track_m.iter().copied()).collect();
    let wheel_errors: Vec<f64> =
        runs.iter().flat_map(|run| run.odometry_only_cross_track_m.iter().copied()).collect();
    let sum = |of: fn(&NavigateRun) -> usize| runs.iter().map(of).sum::<usize>();
    let middle = |of: fn(&NavigateRun) -> f64| median(runs.iter().map(of).collect()).unwrap_or(0.0);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let frames = sum(|run| run.frames).max(1) as f64;
    NavigateReport {
        trial: options.trial,
        trials: runs.len(),
        arrived: runs.iter().filter(|run| run.arrived).count(),
        cross_track_m_mean: mean(&errors),
        cross_track_m_p95: quantile(errors.clone(), 0.95).unwrap_or(0.0),
        cross_track_m_max: errors.iter().copied().fold(0.0, f64::max),
        odometry_only_arrived: runs.iter().filter(|run| run.odometry_only_arrived == Some(true)).count(),
        odometry_only_cross_track_m_mean: mean(&wheel_errors),
        closure_rate: sum(|run| run.closures) as f64 / frames,
        believed_rate: sum(|run| run.believed) as f64 / frames,
        false_closures: sum(|run| run.false_closures),
        false_believed: sum(|run| run.false_believed),
        unrecognised_run_max: runs.iter().map(|run| run.unrecognised_run).max().unwrap_or(0),
        times_lost: runs.iter().map(|run| run.times_lost).sum(),
        collisions: runs.iter().map(|run| run.collisions).sum(),
        goal_error_m_median: middle(|run| run.goal_error_m),
        driven_m_median: middle(|run| run.driven_m),
        taught_m_median: middle(|run| run.taught_m),
        planned_m_median: middle(|run| run.planned_m.unwrap_or(0.0)),
        kidnapped: kidnapped(&runs),
        runs,
    }
}

fn kidnapped(runs: &[NavigateRun]) -> Option<KidnappedReport> {
    let all: Vec<Kidnapping> = runs.iter().filter_map(|run| run.kidnapping).collect();
    let found = || all.iter().filter(|run| run.found_s.is_some() && run.believed_elsewhere == 0);
    (!all.is_empty()).then(|| KidnappedReport {
        kidnapped: all.len(),
        relocalized: found().count(),
        relocalized_within_one_turn: found().filter(|run| run.turned_rad.to_degrees() <= 360.0).count(),
        believed_elsewhere: all.iter().filter(|run| run.believed_elsewhere > 0).count(),
        noticed_s_median: median(all.iter().filter_map(|run| run.noticed_s).collect()).unwrap_or(0.0),
        turned_deg_median: median(all.iter().map(|run| run.turned_rad.to_degrees()).collect()).unwrap_or(0.0),
    })
}
