//! How one pose lies to another, and how well that is known.

use fabmap::codec::{DecodeError, Reader, Writer};
use nalgebra::{Isometry3, Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3};

use crate::metric::Odometry;
use posegraph::{PlanarPose, Pose};

/// A pose in the frame of another, seen from above, with the covariance of what may be wrong about
/// it: along its own axes and about them, in m² and rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePose {
    pose: PlanarPose,
    covariance: Matrix3<f64>,
}

/// Numbers that measure nothing.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RelativePoseError {
    /// A number is NaN or infinite.
    #[error("a relative pose has a number that is not finite; leave it out if nothing was measured")]
    NotFinite,
    /// The covariance is none.
    #[error(
        "the covariance of a relative pose is not symmetric with no negative eigenvalue; give that of x, y and \
         heading, in m² and rad²"
    )]
    NotACovariance,
    /// The quaternion is no rotation.
    #[error(
        "the quaternion of a relative pose has length {norm}; send a unit quaternion as x, y, z, w, (0, 0, 0, 1) for none"
    )]
    NotUnit {
        /// Its length.
        norm: f64,
    },
    /// A number beyond all that robots measure.
    #[error("a relative pose has the number {value:e}; send metres, m² and rad²")]
    TooLarge {
        /// The number.
        value: f64,
    },
}

impl RelativePose {
    /// What is finite and has a covariance by how it was made.
    pub(crate) fn known(pose: PlanarPose, covariance: Matrix3<f64>) -> Self {
        Self { pose, covariance }
    }

    /// What was measured, and how well.
    ///
    /// # Errors
    /// [`RelativePoseError`] if a number is not finite or the covariance none.
    pub fn new(pose: PlanarPose, covariance: Matrix3<f64>) -> Result<Self, RelativePoseError> {
        if !pose.is_finite() || covariance.iter().any(|value| !value.is_finite()) {
            return Err(RelativePoseError::NotFinite);
        }
        let scale = covariance.amax();
        let symmetric = (covariance - covariance.transpose()).amax() <= 1e-6 * scale;
        if !symmetric || covariance.symmetric_eigenvalues().min() < -1e-6 * scale {
            return Err(RelativePoseError::NotACovariance);
        }
        Ok(Self { pose, covariance })
    }

    /// What was measured in space, seen from above. `covariance` is 6 x 6, row by row, of (x, y, z,
    /// rotation about x, y, z) about the axes that the pose is in, in m² and rad².
    ///
    /// # Errors
    /// [`RelativePoseError`] if a number is not finite or beyond all that robots measure, the
    /// quaternion is no rotation or the covariance none.
    pub fn measured_in_space(
        position_m: [f64; 3],
        orientation_xyzw: [f64; 4],
        covariance: &[f64; 36],
    ) -> Result<Self, RelativePoseError> {
        let within = |values: &[f64], most: f64| match values
            .iter()
            .find(|value| value.is_nan() || value.abs() > most)
        {
            Some(value) if value.is_finite() => Err(RelativePoseError::TooLarge { value: *value }),
            Some(_) => Err(RelativePoseError::NotFinite),
            None => Ok(()),
        };
        within(&position_m, Odometry::MAX_POSITION_M)?;
        within(covariance, Odometry::MAX_VARIANCE)?;
        let [i, j, k, w] = orientation_xyzw;
        let quaternion = Quaternion::new(w, i, j, k);
        let norm = quaternion.norm();
        if norm.is_nan() || (norm - 1.0).abs() > Odometry::MAX_NORM_ERROR {
            return Err(RelativePoseError::NotUnit { norm });
        }
        let rotation = UnitQuaternion::from_quaternion(quaternion);
        let pose =
            PlanarPose::seen_from_above(&Isometry3::from_parts(Vector3::from(position_m).into(), rotation));
        // From the axes that the pose is in to its own.
        let turned = PlanarPose::new(0.0, 0.0, pose.heading_rad()).inverse().adjoint();
        let covariance = Matrix6::from_row_slice(covariance);
        if (covariance - covariance.transpose()).amax() > 1e-6 * covariance.amax() {
            return Err(RelativePoseError::NotACovariance);
        }
        let covariance = seen_from_above(&covariance);
        Self::new(pose, turned * covariance * turned.transpose())
    }

    /// The very same pose.
    #[must_use]
    pub fn none() -> Self {
        Self { pose: PlanarPose::identity(), covariance: Matrix3::zeros() }
    }

    /// The pose.
    #[must_use]
    pub fn pose(&self) -> &PlanarPose {
        &self.pose
    }

    /// Covariance of x, y and heading, along the pose's own axes.
    #[must_use]
    pub fn covariance(&self) -> &Matrix3<f64> {
        &self.covariance
    }

    /// Standard deviation of the position in the direction in which it is largest, in metres.
    #[must_use]
    pub fn position_sigma_m(&self) -> f64 {
        let position = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        position.symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    /// `next`, which is measured from here, as measured from where this is measured from.
    #[must_use]
    pub fn then(&self, next: &RelativePose) -> Self {
        let carried = next.pose.inverse().adjoint();
        Self {
            pose: self.pose.compose(&next.pose),
            covariance: carried * self.covariance * carried.transpose() + next.covariance,
        }
    }

    /// Where this was measured from, as measured from here.
    #[must_use]
    pub fn back(&self) -> Self {
        let carried = self.pose.adjoint();
        Self { pose: self.pose.inverse(), covariance: carried * self.covariance * carried.transpose() }
    }

    /// Inverse of the covariance; what is known better than to a millimetre or a thousandth of a
    /// radian counts as known so well.
    #[must_use]
    pub fn information(&self) -> Matrix3<f64> {
        let symmetric = (self.covariance + self.covariance.transpose()) * 0.5;
        let floored = symmetric + Matrix3::from_diagonal_element(1e-6);
        floored.try_inverse().map_or_else(Matrix3::identity, |inverse| (inverse + inverse.transpose()) * 0.5)
    }

    pub(crate) fn encode(&self, writer: &mut Writer) {
        encode_planar(&self.pose, writer);
        self.covariance.iter().for_each(|&value| writer.f64(value));
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let pose = decode_planar(reader)?;
        let mut covariance = Matrix3::zeros();
        for value in covariance.iter_mut() {
            *value = reader.f64()?;
        }
        Self::new(pose, covariance).map_err(DecodeError::invalid)
    }
}

/// Appends x, y and heading; the bits of every number are kept.
pub(crate) fn encode_planar(pose: &PlanarPose, writer: &mut Writer) {
    [pose.x_m(), pose.y_m(), pose.heading_rad()].into_iter().for_each(|value| writer.f64(value));
}

pub(crate) fn decode_planar(reader: &mut Reader<'_>) -> Result<PlanarPose, DecodeError> {
    let pose = PlanarPose::new(reader.f64()?, reader.f64()?, reader.f64()?);
    if pose.is_finite() { Ok(pose) } else { Err(DecodeError::invalid("a pose")) }
}

/// The covariance of x, y and heading.
pub(super) fn seen_from_above(covariance: &Matrix6<f64>) -> Matrix3<f64> {
    const SEEN_FROM_ABOVE: [usize; 3] = [0, 1, 5];
    let of = |row, column| covariance[(SEEN_FROM_ABOVE[row], SEEN_FROM_ABOVE[column])];
    Matrix3::from_fn(|row, column| (of(row, column) + of(column, row)) * 0.5)
}

#[cfg(test)]
pub(super) mod tests;
