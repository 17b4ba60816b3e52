//! Poses in the plane: SE(2).

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

use crate::pose::{Linearized, Pose};

/// A pose in the plane: SE(2). Metres and radians; the heading lies in (-π, π].
#[derive(Clone, Copy, Debug)]
pub struct PlanarPose {
    x: f64,
    y: f64,
    heading: f64,
    cosine: f64,
    sine: f64,
}

impl PlanarPose {
    /// A heading beyond half a turn comes to the same one within.
    #[must_use]
    pub fn new(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        let heading = wrapped(heading_rad);
        let (sine, cosine) = heading.sin_cos();
        Self { x: x_m, y: y_m, heading, cosine, sine }
    }

    /// What is left of a pose in space that is seen from above: x, y and yaw.
    #[must_use]
    pub fn seen_from_above(pose: &Isometry3<f64>) -> Self {
        let (_, _, yaw) = pose.rotation.euler_angles();
        Self::new(pose.translation.x, pose.translation.y, yaw)
    }

    /// The pose in space, on the ground.
    #[must_use]
    pub fn on_the_ground(&self) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading);
        Isometry3::from_parts(Translation3::new(self.x, self.y, 0.0), rotation)
    }

    /// Position along x, in metres.
    #[must_use]
    pub fn x_m(&self) -> f64 {
        self.x
    }

    /// Position along y, in metres.
    #[must_use]
    pub fn y_m(&self) -> f64 {
        self.y
    }

    /// Angle from the x axis, counterclockwise, in radians.
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        self.heading
    }

    fn turned(&self, x: f64, y: f64) -> [f64; 2] {
        [self.cosine * x - self.sine * y, self.sine * x + self.cosine * y]
    }

    fn turned_back(&self, x: f64, y: f64) -> [f64; 2] {
        [self.cosine * x + self.sine * y, self.cosine * y - self.sine * x]
    }
}

/// Sine and cosine follow from the heading.
impl PartialEq for PlanarPose {
    fn eq(&self, other: &Self) -> bool {
        [self.x, self.y, self.heading] == [other.x, other.y, other.heading]
    }
}

/// The same angle in (-π, π]; one that lies there already keeps its bits.
pub(super) fn wrapped(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let within = angle - (angle / (2.0 * PI)).round() * (2.0 * PI);
    if within <= -PI { PI } else { within.min(PI) }
}

impl Pose<3> for PlanarPose {
    const SPACE: usize = 2;
    const CHI_SQUARED_MILLION: f64 = 30.665;
    const CHI_SQUARED_HUNDRED: f64 = 11.345;
    const CHI_SQUARED_MEDIAN: f64 = 2.366;
    const UNIT_BALL: f64 = 4.0 / 3.0 * PI;

    fn identity() -> Self {
        Self { x: 0.0, y: 0.0, heading: 0.0, cosine: 1.0, sine: 0.0 }
    }

    fn compose(&self, other: &Self) -> Self {
        let [x, y] = self.turned(other.x, other.y);
        Self::new(self.x + x, self.y + y, self.heading + other.heading)
    }

    fn inverse(&self) -> Self {
        let [x, y] = self.turned_back(-self.x, -self.y);
        Self::new(x, y, -self.heading)
    }

    fn retract(&self, step: &SVector<f64, 3>) -> Self {
        let [x, y] = self.turned(step[0], step[1]);
        Self::new(self.x + x, self.y + y, self.heading + step[2])
    }

    fn error(measurement: &Self, from: &Self, to: &Self) -> SVector<f64, 3> {
        let [x, y] = from.turned_back(to.x - from.x, to.y - from.y);
        let [x, y] = measurement.turned_back(x - measurement.x, y - measurement.y);
        SVector::from([x, y, wrapped(to.heading - from.heading - measurement.heading)])
    }

    fn linearized(measurement: &Self, from: &Self, to: &Self) -> Linearized<3> {
        let [x, y] = from.turned_back(to.x - from.x, to.y - from.y);
        let [error_x, error_y] = measurement.turned_back(x - measurement.x, y - measurement.y);
        let error =
            SVector::from([error_x, error_y, wrapped(to.heading - from.heading - measurement.heading)]);
        let cosine = measurement.cosine;
        let sine = measurement.sine;
        let [turn_x, turn_y] = measurement.turned_back(y, -x);
        let by_from = SMatrix::<f64, 3, 3>::new(
            -cosine, -sine, turn_x, //
            sine, -cosine, turn_y, //
            0.0, 0.0, -1.0,
        );
        let [forward_x, forward_y] = from.turned_back(to.cosine, to.sine);
        let [forward_x, forward_y] = measurement.turned_back(forward_x, forward_y);
        let by_to = SMatrix::<f64, 3, 3>::new(
            forward_x, -forward_y, 0.0, //
            forward_y, forward_x, 0.0, //
            0.0, 0.0, 1.0,
        );
        Linearized { error, by_from, by_to }
    }

    fn rotation(&self) -> Matrix3<f64> {
        Matrix3::new(self.cosine, -self.sine, 0.0, self.sine, self.cosine, 0.0, 0.0, 0.0, 1.0)
    }

    fn position(&self) -> Vector3<f64> {
        Vector3::new(self.x, self.y, 0.0)
    }

    fn nearest(matrix: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        let heading = (matrix[(1, 0)] - matrix[(0, 1)]).atan2(matrix[(0, 0)] + matrix[(1, 1)]);
        Self::new(position.x, position.y, heading)
    }

    fn adjoint(&self) -> SMatrix<f64, 3, 3> {
        SMatrix::<f64, 3, 3>::new(
            self.cosine,
            -self.sine,
            self.y, //
            self.sine,
            self.cosine,
            -self.x, //
            0.0,
            0.0,
            1.0,
        )
    }

    fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.heading.is_finite()
    }
}
