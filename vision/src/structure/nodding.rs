//! How a robot moves over a floor, and nods on the way.

use nalgebra::{Matrix3, Matrix5, Rotation3, Vector2, Vector3, Vector5};
use posegraph::{PlanarPose, Pose};
use topomap::metric::RelativePose;

/// A planar motion of `base_link`, and how much further the robot is tilted at its end than at its
/// beginning: it nods when it brakes, and floors are not even. Half a degree shifts a whole image
/// as far as a way of a metre moves what is 20 m ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    planar: PlanarPose,
    /// About the robot's own x and y, in radians.
    tilt_rad: Vector2<f64>,
    rotation: Matrix3<f64>,
}

/// Standard deviation of the tilt about either axis: a degree.
const TILT_SIGMA_RAD: f64 = std::f64::consts::PI / 180.0;

impl Motion {
    /// Position, heading and tilt, in the order of a step.
    pub(super) const AXES: [usize; 5] = [0, 1, 2, 3, 4];

    /// Without any tilt.
    pub(super) fn level(planar: PlanarPose) -> Self {
        Self::new(planar, Vector2::zeros())
    }

    fn new(planar: PlanarPose, tilt_rad: Vector2<f64>) -> Self {
        let level = Rotation3::from_axis_angle(&Vector3::z_axis(), planar.heading_rad());
        let tilted = Rotation3::from_scaled_axis(Vector3::new(tilt_rad.x, tilt_rad.y, 0.0));
        Self { planar, tilt_rad, rotation: (level * tilted).into_inner() }
    }

    pub(super) fn planar(&self) -> PlanarPose {
        self.planar
    }

    pub(super) fn rotation(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    fn position_m(&self) -> Vector3<f64> {
        Vector3::new(self.planar.x_m(), self.planar.y_m(), 0.0)
    }

    /// A point seen from the end of the motion, as seen from its beginning.
    pub(super) fn carried(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_m + self.position_m()
    }

    /// The inverse of [`Motion::carried`].
    pub(super) fn seen_from(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.tr_mul(&(point_m - self.position_m()))
    }

    /// The motion a step away.
    pub(super) fn retract(&self, step: &Vector5<f64>) -> Self {
        let planar = self.planar.retract(&step.fixed_rows::<3>(0).into_owned());
        Self::new(planar, self.tilt_rad + step.fixed_rows::<2>(3))
    }

    /// The motion a little way along one axis.
    pub(super) fn varied(&self, axis: usize, by: f64) -> Self {
        self.retract(&Vector5::from_fn(|row, _| if row == axis { by } else { 0.0 }))
    }

    /// The tilt alone, as a step.
    pub(super) fn tilt(&self) -> Vector5<f64> {
        Vector5::new(0.0, 0.0, 0.0, self.tilt_rad.x, self.tilt_rad.y)
    }

    /// How far it is from where wheels lead, without a tilt.
    pub(super) fn off(&self, wheels: &RelativePose) -> Vector5<f64> {
        let planar = PlanarPose::error(wheels.pose(), &PlanarPose::identity(), &self.planar);
        self.tilt() + Vector5::new(planar.x, planar.y, planar.z, 0.0, 0.0)
    }

    /// What is known of the tilt alone.
    pub(super) fn information_on_tilt() -> Matrix5<f64> {
        let variance = TILT_SIGMA_RAD * TILT_SIGMA_RAD;
        Matrix5::from_diagonal(&Vector5::new(0.0, 0.0, 0.0, 1.0 / variance, 1.0 / variance))
    }

    /// What wheels know, and what is known of the tilt.
    pub(super) fn information(wheels: &RelativePose) -> Matrix5<f64> {
        let mut information = Self::information_on_tilt();
        information.fixed_view_mut::<3, 3>(0, 0).copy_from(&wheels.information());
        information
    }

    /// The inverse of [`Motion::information`].
    pub(super) fn covariance(wheels: &RelativePose) -> Matrix5<f64> {
        let variance = TILT_SIGMA_RAD * TILT_SIGMA_RAD;
        let mut covariance = Matrix5::from_diagonal(&Vector5::new(0.0, 0.0, 0.0, variance, variance));
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(wheels.covariance());
        covariance
    }
}
