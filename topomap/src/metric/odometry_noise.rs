//! How far wheels can be trusted.

use nalgebra::{Isometry3, Matrix3, Vector3};
use posegraph::{PlanarPose, Pose};

use super::odometry::Odometry;
use super::place_spacing::PlaceSpacing;
use super::relative_pose::{RelativePose, seen_from_above};

/// How far wheels can be trusted, where their own covariance does not say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryNoise {
    /// Of a distance, at least 0.
    pub translation_share: f64,
    /// Of the heading, per metre driven, in rad/m, at least 0.
    pub heading_rad_per_m: f64,
    /// Of a turn, at least 0.
    pub turn_share: f64,
    /// Of any position, in metres, above 0.
    pub position_floor_m: f64,
    /// Of any heading, in radians, above 0.
    pub heading_floor_rad: f64,
}

/// Steps that are as long as this have all of the floors.
const WHOLE_FLOORS_SPACINGS: f64 = 0.2;

impl Default for OdometryNoise {
    fn default() -> Self {
        Self {
            translation_share: 0.05,
            heading_rad_per_m: 0.05,
            turn_share: 0.05,
            position_floor_m: 0.01,
            heading_floor_rad: 0.01,
        }
    }
}

impl OdometryNoise {
    /// The motion from one odometry of a session to a later one.
    #[must_use]
    pub fn between(&self, before: &Odometry, now: &Odometry) -> RelativePose {
        let from = PlanarPose::seen_from_above(before.pose());
        let to = PlanarPose::seen_from_above(now.pose());
        let pose = from.inverse().compose(&to);
        let covariance = added(before, now, (&from, &to)).unwrap_or_else(|| self.covariance(&pose));
        RelativePose::known(pose, covariance)
    }

    /// The same of one of many steps that are put together: shorter ones have a share of the floors, so that a way
    /// is no less sure where more images are sent on it, and none is less sure for standing.
    #[must_use]
    pub fn of_step(&self, before: &Odometry, now: &Odometry, spacing: &PlaceSpacing) -> RelativePose {
        let [from, to] = [before, now].map(|odometry| PlanarPose::seen_from_above(odometry.pose()));
        let way_spacings = spacing.way(&from.inverse().compose(&to));
        let share = (way_spacings / WHOLE_FLOORS_SPACINGS).min(1.0).sqrt();
        let position_floor_m = share * self.position_floor_m;
        let heading_floor_rad = share * self.heading_floor_rad;
        Self { position_floor_m, heading_floor_rad, ..*self }.between(before, now)
    }

    /// A motion of which nothing else is known, seen from above.
    #[must_use]
    pub fn from_above(&self, motion: &Isometry3<f64>) -> RelativePose {
        self.of_motion(&PlanarPose::seen_from_above(motion))
    }

    /// A motion of which nothing else is known.
    #[must_use]
    pub fn of_motion(&self, motion: &PlanarPose) -> RelativePose {
        RelativePose::known(*motion, self.covariance(motion))
    }

    fn covariance(&self, motion: &PlanarPose) -> Matrix3<f64> {
        let distance_m = motion.x_m().hypot(motion.y_m());
        let square = |value: f64| value * value;
        let heading = square(self.heading_floor_rad)
            + square(self.heading_rad_per_m * distance_m)
            + square(self.turn_share * motion.heading_rad());
        let along = square(self.position_floor_m) + square(self.translation_share * distance_m);
        // A heading that is wrong from half of the way on.
        let position = along + heading * square(distance_m / 2.0);
        Matrix3::from_diagonal(&Vector3::new(position, position, heading))
    }
}

/// What the robot's own covariance has grown by on the way, along the robot's own axes, if it has
/// grown. What was wrong about the heading before moves the position that the way leads to: that is
/// not of this way, so it is taken off, N = Σ' - F Σ Fᵀ with F the derivative of the pose after by
/// the one before.
fn added(before: &Odometry, now: &Odometry, (from, to): (&PlanarPose, &PlanarPose)) -> Option<Matrix3<f64>> {
    let [x, y] = [to.x_m() - from.x_m(), to.y_m() - from.y_m()];
    let carried = Matrix3::new(1.0, 0.0, -y, 0.0, 1.0, x, 0.0, 0.0, 1.0);
    let [before, now] = [seen_from_above(before.covariance()?), seen_from_above(now.covariance()?)];
    let grown = now - carried * before * carried.transpose();
    // From the axes of odom to the robot's own.
    let turned = PlanarPose::new(0.0, 0.0, to.heading_rad()).inverse().adjoint();
    let own = turned * grown * turned.transpose();
    let own = (own + own.transpose()) * 0.5;
    let spread = own.symmetric_eigenvalues();
    (spread.max() > 0.0 && spread.min() >= -1e-7 * own.amax()).then_some(own)
}

#[cfg(test)]
mod tests;
