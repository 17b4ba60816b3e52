//! Ways through a building that a robot can drive.

mod free_space;

use nalgebra::Vector2;

use crate::floor_plan::FloorPlan;
use crate::pose::{Pose, wrapped};
use crate::worlds::NamedRoute;

pub use free_space::FreeSpace;

/// A way as a line of points, two centimetres apart at most.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    points: Vec<Vector2<f64>>,
    /// Metres from the start to each point.
    along_m: Vec<f64>,
}

/// Why there is no such way.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RouteError {
    /// Nothing to drive along.
    #[error("a route needs two different corners at least")]
    TooShort,
    /// A wall or furniture is in the way.
    #[error("the robot does not fit at ({x_m:.2}, {y_m:.2}); move the route's corners away from it")]
    Blocked {
        /// Where, in metres.
        x_m: f64,
        /// Where, in metres.
        y_m: f64,
    },
    /// No way leads from one place to the other.
    #[error("no way is wide enough from ({:.2}, {:.2}) to ({:.2}, {:.2})", .from[0], .from[1], .to[0], .to[1])]
    Unreachable {
        /// The start, in metres.
        from: [f64; 2],
        /// The goal, in metres.
        to: [f64; 2],
    },
}

/// From point to point of a route.
const SPACING_M: f64 = 0.02;

impl Route {
    /// Largest radius at which corners are rounded, in metres.
    pub const CORNER_RADIUS_M: f64 = 0.6;

    /// Straight lines from corner to corner, rounded where there is room; where it turns back, it
    /// does so on the spot.
    ///
    /// # Errors
    /// [`RouteError::TooShort`] if all corners are one.
    pub fn through(corners: &[Vector2<f64>]) -> Result<Self, RouteError> {
        let mut corners = corners.to_vec();
        corners.dedup_by(|a, b| (*a - *b).norm() < 1e-6);
        let [first, .., last] = corners.as_slice() else { return Err(RouteError::TooShort) };
        let mut points = vec![*first];
        for triple in corners.windows(3) {
            round_corner([triple[0], triple[1], triple[2]], &mut points);
        }
        extend_to(&mut points, *last);
        let mut along_m = vec![0.0];
        for pair in points.windows(2) {
            along_m.push(along_m[along_m.len() - 1] + (pair[1] - pair[0]).norm());
        }
        Ok(Self { points, along_m })
    }

    /// A named route through a plan, if a robot of that radius fits.
    ///
    /// # Errors
    /// [`RouteError`] if it does not fit, or the route has no length.
    pub fn named(plan: &FloorPlan, route: &NamedRoute, radius_m: f64) -> Result<Self, RouteError> {
        let whole = Self::through(&route.corners)?;
        let cut = route.length_m.map_or_else(|| whole.clone(), |length_m| whole.cut(length_m));
        cut.check(plan, radius_m)?;
        Ok(cut)
    }

    /// Its first metres.
    #[must_use]
    pub fn cut(&self, length_m: f64) -> Self {
        let count = self.along_m.partition_point(|&along| along <= length_m).max(2).min(self.points.len());
        Self { points: self.points[..count].to_vec(), along_m: self.along_m[..count].to_vec() }
    }

    /// Whether a robot of that radius fits all along.
    ///
    /// # Errors
    /// [`RouteError::Blocked`] with the first place where it does not.
    pub fn check(&self, plan: &FloorPlan, radius_m: f64) -> Result<(), RouteError> {
        let tight = self.points.iter().find(|&&point| plan.clearance_m(point) < radius_m);
        tight.map_or(Ok(()), |point| Err(RouteError::Blocked { x_m: point.x, y_m: point.y }))
    }

    /// Its points, from the start.
    #[must_use]
    pub fn points(&self) -> &[Vector2<f64>] {
        &self.points
    }

    /// From its start to its end, in metres.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.along_m[self.along_m.len() - 1]
    }

    /// Where it starts, looking along it.
    #[must_use]
    pub fn start(&self) -> Pose {
        let first = self.points[0];
        let ahead = self.at(0.1);
        let way = ahead - first;
        Pose::new(first.x, first.y, way.y.atan2(way.x))
    }

    /// The point so many metres from its start, or its end.
    #[must_use]
    pub fn at(&self, along_m: f64) -> Vector2<f64> {
        let index = self.along_m.partition_point(|&along| along < along_m);
        self.points[index.min(self.points.len() - 1)]
    }

    /// Metres from a point to the nearest point of the route.
    #[must_use]
    pub fn distance_m(&self, point: Vector2<f64>) -> f64 {
        self.points.iter().map(|on| (on - point).norm()).fold(f64::INFINITY, f64::min)
    }
}

fn extend_to(points: &mut Vec<Vector2<f64>>, end: Vector2<f64>) {
    let start = points[points.len() - 1];
    let steps = ((end - start).norm() / SPACING_M).ceil();
    points.extend((1..=steps as usize).map(|step| start + (end - start) * (step as f64 / steps)));
}

/// Goes to the corner and round it, by an arc that touches both sides.
fn round_corner([before, corner, after]: [Vector2<f64>; 3], points: &mut Vec<Vector2<f64>>) {
    let (inward, outward) = (corner - before, after - corner);
    let turn = inward.perp(&outward).atan2(inward.dot(&outward));
    let half = (turn.abs() / 2.0).tan();
    // Half of each side belongs to this corner.
    let room = inward.norm().min(outward.norm()) / 2.0;
    let radius = Route::CORNER_RADIUS_M.min(room / half);
    if turn.abs() < 1e-3 || radius < 0.05 {
        extend_to(points, corner);
        return;
    }
    let (inward, outward) = (inward.normalize(), outward.normalize());
    extend_to(points, corner - inward * (radius * half));
    let start = points[points.len() - 1];
    let left = Vector2::new(-inward.y, inward.x) * turn.signum();
    let steps = (turn.abs() * radius / SPACING_M).ceil();
    points.extend((1..=steps as usize).map(|step| {
        let angle = turn.abs() * step as f64 / steps;
        start + inward * (radius * angle.sin()) + left * (radius * (1.0 - angle.cos()))
    }));
    let end = corner + outward * (radius * half);
    if (points[points.len() - 1] - end).norm() > 1e-9 {
        points.push(end);
    }
}

/// Drives along a route by the true pose, as a person with a joystick does who sees where the robot
/// is.
#[derive(Clone, Debug)]
pub struct RouteFollower {
    route: Route,
    /// How far along the robot has come.
    along_m: f64,
}

impl RouteFollower {
    const LOOK_AHEAD_M: f64 = 0.3;
    const ARRIVED_M: f64 = 0.05;

    /// From its start.
    #[must_use]
    pub fn new(route: Route) -> Self {
        Self { route, along_m: 0.0 }
    }

    /// The route.
    #[must_use]
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// How far along the robot has come, in metres.
    #[must_use]
    pub fn along_m(&self) -> f64 {
        self.along_m
    }

    /// Speed ahead in m/s, at most `speed_m_s`, and turn to the left in rad/s; `None` at the end.
    pub fn steer(&mut self, pose: &Pose, speed_m_s: f64) -> Option<[f64; 2]> {
        let position = pose.position();
        // What comes soon, so that a crossing of the route with itself is not taken as a short cut.
        let ahead = (0..=25).map(|step| self.along_m + SPACING_M * f64::from(step));
        let gap = |along_m: f64| (self.route.at(along_m) - position).norm();
        let nearest = ahead.min_by(|&a, &b| gap(a).total_cmp(&gap(b)));
        self.along_m = nearest.unwrap_or(self.along_m).min(self.route.length_m());
        let left_m = self.route.length_m() - self.along_m;
        if left_m < Self::ARRIVED_M {
            return None;
        }
        let target = self.route.at(self.along_m + Self::LOOK_AHEAD_M) - position;
        let off_rad = wrapped(target.y.atan2(target.x) - pose.heading_rad);
        // Slower in curves, and on the spot where the way goes back.
        let speed = speed_m_s * (1.0 - off_rad.abs() / 1.0).max(0.0) * (left_m / 0.3).clamp(0.25, 1.0);
        Some([speed, (2.5 * off_rad).clamp(-1.5, 1.5)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(corners: &[[f64; 2]]) -> Vec<Vector2<f64>> {
        corners.iter().copied().map(Vector2::from).collect()
    }

    #[test]
    fn corners_are_rounded_and_lengths_are_those_of_lines_and_arcs() {
        let route = Route::through(&points(&[[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]])).unwrap();
        let radius = Route::CORNER_RADIUS_M;
        let expected = 8.0 - 2.0 * radius + radius * std::f64::consts::FRAC_PI_2;
        assert!((route.length_m() - expected).abs() < 1e-3, "{} m, not {expected}", route.length_m());
        assert!(route.points().windows(2).all(|pair| (pair[1] - pair[0]).norm() < 0.021));
        let corner = Vector2::new(4.0, 0.0);
        assert!((route.distance_m(corner) - radius * (2_f64.sqrt() - 1.0)).abs() < 1e-2);
        assert_eq!(Route::through(&points(&[[1.0, 1.0], [1.0, 1.0]])), Err(RouteError::TooShort));
    }
}
