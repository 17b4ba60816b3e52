//! Where something stands on the floor.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry2, Vector2};

/// A pose in the plane of the floor (REP-103: x forward, y left, heading counter-clockwise).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Metres.
    pub x_m: f64,
    /// Metres.
    pub y_m: f64,
    /// Radians; 0 looks along x, π/2 along y.
    pub heading_rad: f64,
}

impl Pose {
    /// The pose with these coordinates.
    #[must_use]
    pub const fn new(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        Self { x_m, y_m, heading_rad }
    }

    /// Its place, without the heading.
    #[must_use]
    pub fn position(&self) -> Vector2<f64> {
        Vector2::new(self.x_m, self.y_m)
    }

    /// The way it looks, of length 1.
    #[must_use]
    pub fn direction(&self) -> Vector2<f64> {
        Vector2::new(self.heading_rad.cos(), self.heading_rad.sin())
    }

    /// The same as an isometry: takes points of this pose's frame to the frame that the pose is in.
    #[must_use]
    pub fn isometry(&self) -> Isometry2<f64> {
        Isometry2::new(self.position(), self.heading_rad)
    }

    /// This pose moved by `motion`, which is in its own frame: self ⊕ motion.
    #[must_use]
    pub fn compose(&self, motion: &Pose) -> Pose {
        let (sin, cos) = self.heading_rad.sin_cos();
        Pose {
            x_m: self.x_m + cos * motion.x_m - sin * motion.y_m,
            y_m: self.y_m + sin * motion.x_m + cos * motion.y_m,
            heading_rad: wrapped(self.heading_rad + motion.heading_rad),
        }
    }

    /// `other` as seen from this pose: ⊖ self ⊕ other.
    #[must_use]
    pub fn relative(&self, other: &Pose) -> Pose {
        let (sin, cos) = self.heading_rad.sin_cos();
        let (x, y) = (other.x_m - self.x_m, other.y_m - self.y_m);
        Pose {
            x_m: cos * x + sin * y,
            y_m: cos * y - sin * x,
            heading_rad: wrapped(other.heading_rad - self.heading_rad),
        }
    }

    /// Metres between two poses.
    #[must_use]
    pub fn distance_m(&self, other: &Pose) -> f64 {
        (self.position() - other.position()).norm()
    }

    /// Where driving `distance_m` while turning by `turn_rad`, both at constant rate, ends: an arc.
    #[must_use]
    pub fn driven(&self, distance_m: f64, turn_rad: f64) -> Pose {
        // (sin a / a, (1 - cos a) / a), by their series where a is small.
        let (along, across) = if turn_rad.abs() < 1e-6 {
            (1.0 - turn_rad * turn_rad / 6.0, turn_rad / 2.0)
        } else {
            (turn_rad.sin() / turn_rad, (1.0 - turn_rad.cos()) / turn_rad)
        };
        self.compose(&Pose::new(distance_m * along, distance_m * across, turn_rad))
    }
}

/// The same angle in [-π, π).
#[must_use]
pub fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_quarter_circle_ends_ahead_to_the_left() {
        let end = Pose::new(1.0, 2.0, 0.0).driven(FRAC_PI_2, FRAC_PI_2);
        assert!(end.distance_m(&Pose::new(2.0, 3.0, 0.0)) < 1e-12);
        assert!((end.heading_rad - FRAC_PI_2).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn relative_undoes_compose(
            [ax, ay, bx, by] in prop::array::uniform4(-20.0..20.0f64), [a, b] in prop::array::uniform2(-3.0..3.0f64),
        ) {
            let (pose, motion) = (Pose::new(ax, ay, a), Pose::new(bx, by, b));
            let found = pose.relative(&pose.compose(&motion));
            prop_assert!(found.distance_m(&motion) < 1e-9);
            prop_assert!(wrapped(found.heading_rad - b).abs() < 1e-9);
        }
    }
}
