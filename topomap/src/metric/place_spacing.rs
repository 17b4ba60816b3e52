//! How far apart places are.

use nalgebra::{Matrix3, Vector3};
use posegraph::PlanarPose;

/// Places reach so far, however close together they are, in metres and radians.
const REACH_M: f64 = 1.0;
const REACH_RAD: f64 = std::f64::consts::FRAC_PI_6;

/// How far apart places are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceSpacing {
    /// In metres, above 0.
    pub distance_m: f64,
    /// Of headings, in radians, above 0.
    pub angle_rad: f64,
}

impl Default for PlaceSpacing {
    fn default() -> Self {
        Self { distance_m: 0.5, angle_rad: 10_f64.to_radians() }
    }
}

impl PlaceSpacing {
    /// Whether a robot at `pose` in a place's frame is still there.
    #[must_use]
    pub fn holds(&self, pose: &PlanarPose) -> bool {
        pose.x_m().hypot(pose.y_m()) <= self.distance_m && pose.heading_rad().abs() <= self.angle_rad
    }

    /// How far a place reaches for a robot that sees how far it is from it.
    #[must_use]
    pub fn reach(&self) -> Self {
        let Self { distance_m, angle_rad } = self;
        Self { distance_m: REACH_M.max(2.0 * distance_m), angle_rad: REACH_RAD.max(3.0 * angle_rad) }
    }

    /// How many spacings a motion is long, by its metres or by its angle, whichever are more.
    #[must_use]
    pub fn way(&self, motion: &PlanarPose) -> f64 {
        let metres = motion.x_m().hypot(motion.y_m()) / self.distance_m;
        metres.max(motion.heading_rad().abs() / self.angle_rad)
    }

    /// Σ_cell.
    pub(crate) fn covariance(&self) -> Matrix3<f64> {
        let deviations = Vector3::new(self.distance_m, self.distance_m, self.angle_rad);
        Matrix3::from_diagonal(&deviations.map(|deviation| deviation * deviation))
    }
}
