//! The line that a robot drives: global, once per plan; local, once per image.

use std::sync::Arc;

use nalgebra::Vector2;

use super::planning::{Route, Travel, Waypoint};
use super::settings::PathSettings;
use posegraph::PlanarPose;

/// A route as points at even distances.
#[derive(Clone, Debug, PartialEq)]
pub struct GlobalPath {
    points: Vec<Vector2<f64>>,
    spacing_m: f64,
}

/// What is driven until the next image: straight back to the global path, and on along it.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalPath {
    global: Arc<GlobalPath>,
    /// The straight line, without its end.
    line: Vec<Vector2<f64>>,
    /// Where the global path is met.
    rejoins: usize,
    /// The first point that may be the target: those before have been reached.
    target: usize,
}

/// Steps in which a curve between two places is drawn before it is cut into even ones.
const CURVE_STEPS: usize = 64;

/// A place whose link leads further off than this from where it looks is left in a straight line,
/// in radians.
const STRAIGHT_FROM_RAD: f64 = 1.0;

impl GlobalPath {
    /// Through the waypoints of a route, by curves that leave and reach each as the robot looked
    /// there.
    #[must_use]
    pub fn new(route: &Route, settings: &PathSettings) -> Self {
        let mut drawn: Vec<Vector2<f64>> = route.waypoints.first().map(position).into_iter().collect();
        for pair in route.waypoints.windows(2) {
            draw_curve(&pair[0], &pair[1], &mut drawn);
        }
        Self { points: evenly(&drawn, settings.spacing_m), spacing_m: settings.spacing_m }
    }

    /// Its points, from the start to the goal.
    #[must_use]
    pub fn points(&self) -> &[Vector2<f64>] {
        &self.points
    }

    /// From its start to its end, in metres.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.spacing_m * self.last() as f64
    }

    /// From a point to its end, in metres.
    #[must_use]
    pub fn remaining_m(&self, index: usize) -> f64 {
        self.spacing_m * self.last().saturating_sub(index) as f64
    }

    /// Of the points within `window_m` along the path of point `around`, the one that is nearest to
    /// the robot. Where the path crosses itself or turns back, the one counts that is driven as the
    /// robot looks.
    #[must_use]
    pub fn nearest(&self, robot: &PlanarPose, around: usize, window_m: f64) -> usize {
        let steps = self.steps(window_m);
        let range = around.saturating_sub(steps)..=(around + steps).min(self.last());
        let here = Vector2::new(robot.x_m(), robot.y_m());
        let gap = |index: usize| {
            let turn_rad = (1.0 - self.direction(index).dot(&direction(robot.heading_rad()))) / 2.0;
            (self.points[index] - here).norm() + METRES_TURNED_ABOUT * turn_rad
        };
        range.min_by(|&a, &b| gap(a).total_cmp(&gap(b))).unwrap_or(around)
    }

    /// Straight from the robot to the point `rejoin_m` further on than the nearest one, then on
    /// along the path.
    #[must_use]
    pub fn local(self: &Arc<Self>, robot: &PlanarPose, nearest: usize, settings: &PathSettings) -> LocalPath {
        let rejoins = (nearest + self.steps(settings.rejoin_m)).min(self.last());
        let mut line =
            evenly(&[Vector2::new(robot.x_m(), robot.y_m()), self.points[rejoins]], self.spacing_m);
        line.pop();
        LocalPath { global: Arc::clone(self), line, rejoins, target: 0 }
    }

    /// How far a robot is from the nearest point, in metres, and how far it looks away from how the
    /// path leads on there, in radians.
    pub(super) fn away(&self, robot: &PlanarPose, around: usize, window_m: f64) -> (f64, f64) {
        let nearest = self.nearest(robot, around, window_m);
        let here = Vector2::new(robot.x_m(), robot.y_m());
        let leads_on = self.direction(nearest);
        ((self.points[nearest] - here).norm(), leads_on.angle(&direction(robot.heading_rad())))
    }

    fn steps(&self, length_m: f64) -> usize {
        (length_m / self.spacing_m).round() as usize
    }

    fn last(&self) -> usize {
        self.points.len().saturating_sub(1)
    }

    /// The way it leads on from a point, of length 1; none at all of a single point.
    fn direction(&self, index: usize) -> Vector2<f64> {
        let from = index.min(self.last().saturating_sub(1));
        let step = self.points[self.last().min(from + 1)] - self.points[from];
        step.try_normalize(0.0).unwrap_or_default()
    }
}

/// How much further off a point counts that is driven the other way.
const METRES_TURNED_ABOUT: f64 = 0.5;

impl LocalPath {
    /// The first point that is more than `target_m` from the robot, beyond those that were targets
    /// before; or its end.
    pub fn target(&mut self, robot: &PlanarPose, target_m: f64) -> Vector2<f64> {
        let here = Vector2::new(robot.x_m(), robot.y_m());
        while self.target + 1 < self.len() && (self.point(self.target) - here).norm() <= target_m {
            self.target += 1;
        }
        self.point(self.target)
    }

    /// All its points.
    pub fn points(&self) -> impl Iterator<Item = Vector2<f64>> {
        (0..self.len()).map(|index| self.point(index))
    }

    fn len(&self) -> usize {
        self.line.len() + self.global.points.len() - self.rejoins
    }

    fn point(&self, index: usize) -> Vector2<f64> {
        match index.checked_sub(self.line.len()) {
            None => self.line[index],
            Some(beyond) => self.global.points[self.rejoins + beyond],
        }
    }
}

fn position(waypoint: &Waypoint) -> Vector2<f64> {
    Vector2::new(waypoint.pose.x_m(), waypoint.pose.y_m())
}

fn direction(heading_rad: f64) -> Vector2<f64> {
    Vector2::new(heading_rad.cos(), heading_rad.sin())
}

/// Hermite's cubic from one place to the next.
fn draw_curve(from: &Waypoint, to: &Waypoint, drawn: &mut Vec<Vector2<f64>>) {
    let start = position(from);
    let end = position(to);
    let chord = end - start;
    let tangent = |waypoint: &Waypoint| {
        let ahead = direction(waypoint.pose.heading_rad());
        let ahead = match to.travel {
            Travel::Along => ahead,
            Travel::Against => -ahead,
        };
        let straight = chord.angle(&ahead) > STRAIGHT_FROM_RAD;
        if straight { chord } else { ahead * chord.norm() }
    };
    let leaves = tangent(from);
    let arrives = tangent(to);
    drawn.extend((1..=CURVE_STEPS).map(|step| {
        let t = step as f64 / CURVE_STEPS as f64;
        let square = t * t;
        let cube = t * t * t;
        start * (2.0 * cube - 3.0 * square + 1.0)
            + leaves * (cube - 2.0 * square + t)
            + end * (3.0 * square - 2.0 * cube)
            + arrives * (cube - square)
    }));
}

/// Points along a line, `spacing_m` or a little less apart, its two ends among them.
fn evenly(line: &[Vector2<f64>], spacing_m: f64) -> Vec<Vector2<f64>> {
    let (Some(&first), Some(&last)) = (line.first(), line.last()) else { return Vec::new() };
    let length_m: f64 = line.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let steps = (length_m / spacing_m).round().max(1.0);
    if length_m < spacing_m / 2.0 {
        return vec![last];
    }
    let step_m = length_m / steps;
    let mut points = vec![first];
    let mut along_m = 0.0;
    for pair in line.windows(2) {
        let way = pair[1] - pair[0];
        let way_m = way.norm();
        while (points.len() as f64) < steps && points.len() as f64 * step_m <= along_m + way_m {
            let share = (points.len() as f64 * step_m - along_m) / way_m;
            points.push(pair[0] + way * share);
        }
        along_m += way_m;
    }
    points.push(last);
    points
}

#[cfg(test)]
mod tests;
