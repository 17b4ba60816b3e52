//! What relaxation asks of poses, and poses in space: SE(3). [`crate::planar`] has those in the
//! plane.

use std::f64::consts::PI;
use std::fmt::Debug;

use nalgebra::{Isometry3, Matrix3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// A pose with `D` degrees of freedom, and all that relaxation asks of its group.
///
/// Steps are taken on the right: the first components move the pose along its own axes, in metres,
/// the rest turn it about them, in radians.
pub trait Pose<const D: usize>: Copy + Debug + PartialEq + Send + Sync {
    /// Dimensions of space: 2 or 3.
    const SPACE: usize;
    /// What a squared error of unit variances exceeds once in a million cases: a quantile of χ².
    const CHI_SQUARED_MILLION: f64;
    /// What it exceeds once in a hundred cases.
    const CHI_SQUARED_HUNDRED: f64;
    /// What it exceeds in every other case.
    const CHI_SQUARED_MEDIAN: f64;
    /// Volume of the ball of radius 1 in `D` dimensions.
    const UNIT_BALL: f64;

    /// No motion.
    fn identity() -> Self;

    /// `other`, given relative to this pose, in this pose's own frame.
    #[must_use]
    fn compose(&self, other: &Self) -> Self;

    /// The pose of this one's frame relative to it.
    #[must_use]
    fn inverse(&self) -> Self;

    /// The pose a step away.
    #[must_use]
    fn retract(&self, step: &SVector<f64, D>) -> Self;

    /// What is left of `measurement⁻¹ (from⁻¹ to)`, as a vector: zero where the edge is met
    /// exactly.
    fn error(measurement: &Self, from: &Self, to: &Self) -> SVector<f64, D>;

    /// The error with its derivatives.
    fn linearized(measurement: &Self, from: &Self, to: &Self) -> Linearized<D>;

    /// The rotation, in the upper left corner where space is a plane.
    fn rotation(&self) -> Matrix3<f64>;

    /// The position, its last component zero where space is a plane.
    fn position(&self) -> Vector3<f64>;

    /// The pose at a position, with the rotation that is closest to a matrix.
    fn nearest(matrix: &Matrix3<f64>, position: &Vector3<f64>) -> Self;

    /// What a step at this pose is as a step at the origin that carries the pose along.
    fn adjoint(&self) -> SMatrix<f64, D, D>;

    /// Whether all its numbers are finite.
    fn is_finite(&self) -> bool;
}

/// An error and what it changes by for steps of either pose.
#[derive(Clone, Copy, Debug)]
pub struct Linearized<const D: usize> {
    /// [`Pose::error`].
    pub error: SVector<f64, D>,
    /// Its derivative by a step of the pose that the edge leaves.
    pub by_from: SMatrix<f64, D, D>,
    /// Its derivative by a step of the pose that the edge leads to.
    pub by_to: SMatrix<f64, D, D>,
}

/// SE(3). The rotation enters the error as the vector part of its unit quaternion with w ≥ 0: the
/// sine of half the angle.
impl Pose<6> for Isometry3<f64> {
    const SPACE: usize = 3;
    const CHI_SQUARED_MILLION: f64 = 38.258;
    const CHI_SQUARED_HUNDRED: f64 = 16.812;
    const CHI_SQUARED_MEDIAN: f64 = 5.348;
    const UNIT_BALL: f64 = PI * PI * PI / 6.0;

    fn identity() -> Self {
        Isometry3::identity()
    }

    fn compose(&self, other: &Self) -> Self {
        self * other
    }

    fn inverse(&self) -> Self {
        Isometry3::inverse(self)
    }

    fn retract(&self, step: &SVector<f64, 6>) -> Self {
        let moved = self.rotation * step.fixed_rows::<3>(0);
        let mut rotation =
            self.rotation * UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        // Products of unit quaternions lose their length bit by bit.
        rotation.renormalize_fast();
        Isometry3::from_parts(Translation3::from(self.translation.vector + moved), rotation)
    }

    fn error(measurement: &Self, from: &Self, to: &Self) -> SVector<f64, 6> {
        let left = measurement.inv_mul(&from.inv_mul(to));
        let quaternion = left.rotation.quaternion();
        let sign = if quaternion.w < 0.0 { -1.0 } else { 1.0 };
        let position = &left.translation.vector;
        let vector = quaternion.imag() * sign;
        SVector::from([position.x, position.y, position.z, vector.x, vector.y, vector.z])
    }

    fn linearized(measurement: &Self, from: &Self, to: &Self) -> Linearized<6> {
        let relative = from.inv_mul(to);
        let left = measurement.inv_mul(&relative);
        let quaternion = left.rotation.quaternion();
        let sign = if quaternion.w < 0.0 { -1.0 } else { 1.0 };
        let scalar = quaternion.w * sign;
        let vector = quaternion.imag() * sign;
        let mut error = SVector::<f64, 6>::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&left.translation.vector);
        error.fixed_rows_mut::<3>(3).copy_from(&vector);

        let back = measurement.rotation.inverse().to_rotation_matrix().into_inner();
        let upright = Matrix3::identity() * scalar;
        let across = vector.cross_matrix();
        let mut by_from = SMatrix::<f64, 6, 6>::zeros();
        by_from.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
        by_from.fixed_view_mut::<3, 3>(0, 3).copy_from(&(back * relative.translation.vector.cross_matrix()));
        by_from.fixed_view_mut::<3, 3>(3, 3).copy_from(&((upright - across) * back * -0.5));
        let mut by_to = SMatrix::<f64, 6, 6>::zeros();
        by_to.fixed_view_mut::<3, 3>(0, 0).copy_from(left.rotation.to_rotation_matrix().matrix());
        by_to.fixed_view_mut::<3, 3>(3, 3).copy_from(&((upright + across) * 0.5));
        Linearized { error, by_from, by_to }
    }

    fn rotation(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    fn position(&self) -> Vector3<f64> {
        self.translation.vector
    }

    fn nearest(matrix: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        let decomposition = matrix.svd(true, true);
        let rotation = match (decomposition.u, decomposition.v_t) {
            (Some(u), Some(v_t)) => {
                let handedness =
                    Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * handedness * v_t))
            }
            (Some(_) | None, _) => UnitQuaternion::identity(),
        };
        Isometry3::from_parts(Translation3::from(*position), rotation)
    }

    fn adjoint(&self) -> SMatrix<f64, 6, 6> {
        let rotation = self.rotation.to_rotation_matrix().into_inner();
        let mut adjoint = SMatrix::<f64, 6, 6>::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&(self.translation.vector.cross_matrix() * rotation));
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        adjoint
    }

    fn is_finite(&self) -> bool {
        let finite = |value: &f64| value.is_finite();
        self.translation.vector.iter().all(finite) && self.rotation.coords.iter().all(finite)
    }
}

#[cfg(test)]
mod tests;
