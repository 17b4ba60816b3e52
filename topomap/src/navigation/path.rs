//! The line that a robot drives: global, once per plan; local, once per image.

use std::sync::Arc;

use nalgebra::Vector2;

use super::planning::{Route, Travel, Waypoint};
use super::settings::PathSettings;
use crate::relaxation::PlanarPose;

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

/// A place whose link leads further off than this from where it looks is left in a straight line, in radians.
const STRAIGHT_FROM_RAD: f64 = 1.0;

impl GlobalPath {
    /// Through the waypoints of a route, by curves that leave and reach each as the robot looked there.
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
    pub fn left_m(&self, index: usize) -> f64 {
        self.spacing_m * self.last().saturating_sub(index) as f64
    }

    /// Of the points within `window_m` along the path of point `around`, the one that is nearest to the robot. Where the
    /// path crosses itself or turns back, the one counts that is driven as the robot looks.
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

    /// Straight from the robot to the point `rejoin_m` further on than the nearest one, then on along the path.
    #[must_use]
    pub fn local(self: &Arc<Self>, robot: &PlanarPose, nearest: usize, settings: &PathSettings) -> LocalPath {
        let rejoins = (nearest + self.steps(settings.rejoin_m)).min(self.last());
        let mut line =
            evenly(&[Vector2::new(robot.x_m(), robot.y_m()), self.points[rejoins]], self.spacing_m);
        line.pop();
        LocalPath { global: Arc::clone(self), line, rejoins, target: 0 }
    }

    /// How far a robot is from the nearest point, in metres, and how far it looks away from how the path leads on there, in
    /// radians.
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
    /// The first point that is more than `target_m` from the robot, beyond those that were targets before; or its end.
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
    let (start, end) = (position(from), position(to));
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
    let (leaves, arrives) = (tangent(from), tangent(to));
    drawn.extend((1..=CURVE_STEPS).map(|step| {
        let t = step as f64 / CURVE_STEPS as f64;
        let (square, cube) = (t * t, t * t * t);
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn route(poses: &[PlanarPose]) -> Route {
        let waypoint = |(place, &pose): (u32, &PlanarPose)| Waypoint { place, pose, travel: Travel::Along };
        let waypoints = (0..).zip(poses).map(waypoint).collect();
        Route { part: 0, waypoints, length_m: 0.0 }
    }

    /// Places every half metre along a wavy way.
    fn wavy(phase: f64, turn_rad_per_m: f64) -> Vec<PlanarPose> {
        let mut pose = PlanarPose::new(1.0, -2.0, phase);
        let step = |number: u32| {
            let turn_rad = 0.25 * turn_rad_per_m * (phase + f64::from(number) / 3.0).sin();
            let half = PlanarPose::new(0.0, 0.0, turn_rad);
            pose = pose.compose(&half).compose(&PlanarPose::new(0.5, 0.0, 0.0)).compose(&half);
            pose
        };
        use crate::relaxation::Pose;
        (0..20).map(step).collect()
    }

    proptest! {
        #[test]
        fn the_global_path_goes_through_all_places_at_even_distances(phase in -3.0..3.0f64, turn in 0.0..1.5f64) {
            let (places, settings) = (wavy(phase, turn), PathSettings::default());
            let path = GlobalPath::new(&route(&places), &settings);
            for pair in path.points().windows(2) {
                let step_m = (pair[1] - pair[0]).norm();
                prop_assert!(step_m <= 1.01 * settings.spacing_m && step_m >= 0.9 * settings.spacing_m, "{step_m} m");
            }
            for place in &places {
                let place = Vector2::new(place.x_m(), place.y_m());
                let gap_m = path.points().iter().map(|point| (point - place).norm()).fold(f64::INFINITY, f64::min);
                prop_assert!(gap_m <= settings.spacing_m);
            }
            let length_m: f64 = path.points().windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            prop_assert!((path.length_m() - length_m).abs() < 0.01 * length_m);
        }

        /// Straight from the robot to 40 cm beyond the nearest point, then the rest; targets are further than 20 cm
        /// and never go back.
        #[test]
        fn the_local_path_leads_back(
            phase in -3.0..3.0f64, turn in 0.0..1.5f64, along in 0.0..1.0f64, across_m in -0.5..0.5f64,
        ) {
            let (places, settings) = (wavy(phase, turn), PathSettings::default());
            let path = Arc::new(GlobalPath::new(&route(&places), &settings));
            let index = (along * (path.points().len() - 1) as f64) as usize;
            let (on, ahead) = (path.points()[index], path.direction(index));
            let mut robot = PlanarPose::new(on.x - across_m * ahead.y, on.y + across_m * ahead.x, ahead.y.atan2(ahead.x));
            let nearest = path.nearest(&robot, index, settings.window_m);
            let mut local = path.local(&robot, nearest, &settings);
            let points: Vec<_> = local.points().collect();
            let rejoins = (nearest + 40).min(path.last());
            let rest = path.points().len() - rejoins;
            prop_assert_eq!(&points[points.len() - rest..], &path.points()[rejoins..]);
            let here = Vector2::new(robot.x_m(), robot.y_m());
            prop_assert!(rest == points.len() || (points[0] - here).norm() < 1e-9);
            let straight_m: f64 = points[..=points.len() - rest].windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            prop_assert!((straight_m - (path.points()[rejoins] - points[0]).norm()).abs() < 1e-6);

            let mut last = 0;
            for _ in 0..200 {
                let target = local.target(&robot, settings.target_m);
                let here = Vector2::new(robot.x_m(), robot.y_m());
                prop_assert!(local.target >= last);
                last = local.target;
                let is_end = last + 1 == local.len();
                prop_assert!(is_end || (target - here).norm() > settings.target_m);
                let step = (target - here).cap_magnitude(0.05);
                robot = PlanarPose::new(here.x + step.x, here.y + step.y, 0.0);
            }
        }
    }

    #[test]
    fn a_crossing_is_no_shortcut() {
        // East, a loop to the left, and south through the first leg.
        let corners = [
            (0.0, 0.0, 0.0),
            (2.0, 0.0, 0.0),
            (3.0, 1.0, 1.57),
            (2.0, 2.0, 3.1),
            (1.0, 1.0, -1.57),
            (1.0, -2.0, -1.57),
        ];
        let places = corners.map(|(x, y, heading)| PlanarPose::new(x, y, heading));
        let path = GlobalPath::new(&route(&places), &PathSettings::default());
        let crossing = PlanarPose::new(1.0, 0.0, 0.0);
        let first = path.nearest(&crossing, 90, 1.0);
        assert!((60..140).contains(&first), "{first}");
        let end = path.points().len() - 1;
        let again = PlanarPose::new(1.0, 0.0, -1.57);
        let second = path.nearest(&again, end - 220, 1.0);
        assert!((end - 230..end - 170).contains(&second), "{second} of {end}");
        // Even where both are within the window, the one counts that is driven that way.
        assert_eq!(path.nearest(&again, end / 2, 10.0), second);
    }

    #[test]
    fn a_route_of_one_place_is_a_point() {
        let settings = PathSettings::default();
        let path = Arc::new(GlobalPath::new(&route(&[PlanarPose::new(2.0, 1.0, 0.0)]), &settings));
        assert_eq!((path.length_m(), path.left_m(0)), (0.0, 0.0));
        let robot = PlanarPose::new(0.0, 1.0, 0.0);
        let mut local = path.local(&robot, path.nearest(&robot, 0, 1.0), &settings);
        assert_eq!(local.target(&robot, 5.0), Vector2::new(2.0, 1.0));
        let ahead = local.target(&robot, 0.2);
        assert_eq!(ahead, Vector2::new(2.0, 1.0));
    }
}
