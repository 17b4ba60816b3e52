//! Where a robot's own wheels say it is.

use fabmap::codec::{DecodeError, Reader, Writer};
use nalgebra::{Isometry3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector3};

/// The absolute pose of `base_link` in the session's `odom` frame (REP-105: continuous, drifting),
/// metres and radians (REP-103), with an optional covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    pose: Isometry3<f64>,
    covariance: Option<Box<Matrix6<f64>>>,
}

/// A pose or covariance that no odometry has.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OdometryError {
    /// A number is NaN or infinite.
    #[error("the odometry's {field} is not a finite number; leave odometry out of frames that have none")]
    NotFinite {
        /// `position`, `orientation` or `covariance`.
        field: &'static str,
    },
    /// The orientation is no rotation.
    #[error(
        "the odometry's orientation has length {norm}; send a unit quaternion (x, y, z, w), (0, 0, 0, 1) for none"
    )]
    NotUnit {
        /// Length of the quaternion.
        norm: f64,
    },
    /// The position is in no unit that a robot drives in.
    #[error(
        "the odometry's position is {value:e} m from the origin of its frame; send metres in a frame that begins near the \
         robot, at most {max:e} m from it", max = Odometry::MAX_POSITION_M
    )]
    TooFar {
        /// The coordinate given.
        value: f64,
    },
    /// A variance that says nothing.
    #[error(
        "the odometry's covariance has the value {value:e}; send m² and rad² up to {max:e}, or leave it out if it is not \
         known", max = Odometry::MAX_VARIANCE
    )]
    TooUnsure {
        /// The value given.
        value: f64,
    },
    /// The covariance is not symmetric and positive semi-definite.
    #[error(
        "the odometry's covariance is not symmetric with no negative eigenvalue; send 6 x 6 values, row by row, of \
         (x, y, z, rotation about x, y, z), or leave it out"
    )]
    NotACovariance,
}

/// Distance that odometry may move in no time: stamps and poses are never quite of one instant.
const JUMP_SLACK_M: f64 = 1.0;

impl Odometry {
    /// Farthest that a coordinate may lie from the frame's origin, in metres: beyond any place on
    /// Earth. What is measured from one odometry to the next is then finite, however often it is
    /// added up.
    pub const MAX_POSITION_M: f64 = 1e8;

    /// How far the length of an orientation's quaternion may be from 1.
    pub const MAX_NORM_ERROR: f64 = 0.01;

    /// Largest value of a covariance, in m² or rad²; drivers that do not know send up to 1e9.
    pub const MAX_VARIANCE: f64 = 1e12;

    /// `position_m` is x, y, z; `orientation` a unit quaternion x, y, z, w (1 % off is normalised);
    /// `covariance` 6 x 6, row by row, of (x, y, z, rotation about x, y, z) in m² and rad².
    ///
    /// # Errors
    /// [`OdometryError`] if a number is not finite or beyond its bound, the quaternion no rotation
    /// or the covariance none.
    pub fn new(
        position_m: [f64; 3],
        orientation_xyzw: [f64; 4],
        covariance: Option<&[f64; 36]>,
    ) -> Result<Self, OdometryError> {
        let finite = |values: &[f64], field| {
            if values.iter().all(|value| value.is_finite()) {
                Ok(())
            } else {
                Err(OdometryError::NotFinite { field })
            }
        };
        finite(&position_m, "position")?;
        finite(&orientation_xyzw, "orientation")?;
        if let Some(&value) = position_m.iter().find(|value| value.abs() > Self::MAX_POSITION_M) {
            return Err(OdometryError::TooFar { value });
        }
        let [x, y, z, w] = orientation_xyzw;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm = quaternion.norm();
        if (norm - 1.0).abs() > Self::MAX_NORM_ERROR {
            return Err(OdometryError::NotUnit { norm });
        }
        let covariance = covariance.map(|values| {
            finite(values, "covariance")?;
            if let Some(&value) = values.iter().find(|value| value.abs() > Self::MAX_VARIANCE) {
                return Err(OdometryError::TooUnsure { value });
            }
            let matrix = Matrix6::from_row_slice(values);
            let scale = matrix.amax();
            let symmetric = (matrix - matrix.transpose()).amax() <= 1e-6 * scale;
            let non_negative = || matrix.symmetric_eigenvalues().min() >= -1e-6 * scale;
            if symmetric && non_negative() {
                Ok(Box::new(matrix))
            } else {
                Err(OdometryError::NotACovariance)
            }
        });
        let pose = Isometry3::from_parts(
            Translation3::from(Vector3::from(position_m)),
            UnitQuaternion::from_quaternion(quaternion),
        );
        Ok(Self { pose, covariance: covariance.transpose()? })
    }

    /// Pose of `base_link` in `odom`.
    #[must_use]
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.pose
    }

    /// Covariance of (x, y, z, rotation about x, y, z).
    #[must_use]
    pub fn covariance(&self) -> Option<&Matrix6<f64>> {
        self.covariance.as_deref()
    }

    /// Distance to another pose of the same odom frame, in metres.
    #[must_use]
    pub fn distance_m(&self, other: &Odometry) -> f64 {
        (self.pose.translation.vector - other.pose.translation.vector).norm()
    }

    /// Whether it lies further from an earlier one, in metres, than a robot of that speed comes in
    /// that time.
    #[must_use]
    pub fn has_jumped(&self, before: &Odometry, elapsed_s: f64, max_speed_m_per_s: f64) -> bool {
        self.distance_m(before) > JUMP_SLACK_M + max_speed_m_per_s * elapsed_s
    }

    /// Appends the byte form; the bits of every number are kept.
    pub fn encode(&self, writer: &mut Writer) {
        encode_pose(&self.pose, writer);
        writer.u8(u8::from(self.covariance.is_some()));
        if let Some(covariance) = &self.covariance {
            covariance.iter().for_each(|&value| writer.f64(value));
        }
    }

    /// Reads what [`Odometry::encode`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut or hold no odometry.
    pub fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let pose = decode_pose(reader)?;
        let covariance = match reader.u8()? {
            0 => None,
            1 => {
                let mut matrix = Matrix6::zeros();
                for value in matrix.iter_mut() {
                    *value = reader.f64()?;
                }
                Some(Box::new(matrix))
            }
            other => return Err(DecodeError::invalid(format_args!("covariance flag {other}"))),
        };
        Ok(Self { pose, covariance })
    }
}

pub(crate) fn encode_pose(pose: &Isometry3<f64>, writer: &mut Writer) {
    let quaternion = pose.rotation.quaternion();
    let position = &pose.translation.vector;
    let rotation = &quaternion.coords;
    position.iter().chain(rotation.iter()).for_each(|&value| writer.f64(value));
}

pub(crate) fn decode_pose(reader: &mut Reader<'_>) -> Result<Isometry3<f64>, DecodeError> {
    let mut numbers = [0.0; 7];
    for number in &mut numbers {
        *number = reader.f64()?;
    }
    let [x, y, z, i, j, k, w] = numbers;
    let quaternion = Quaternion::new(w, i, j, k);
    if numbers.iter().any(|number| !number.is_finite()) || (quaternion.norm() - 1.0).abs() > 1e-6 {
        return Err(DecodeError::invalid("a pose"));
    }
    // Not normalised again: the bits must stay those that were written.
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(quaternion)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

    fn diagonal(values: [f64; 6]) -> [f64; 36] {
        let mut matrix = [0.0; 36];
        (0..6).for_each(|i| matrix[7 * i] = values[i]);
        matrix
    }

    #[test]
    fn bytes_give_the_odometry_back_to_the_bit() {
        let covariance = diagonal([0.1, 0.1, 0.0, 0.0, 0.0, 0.02]);
        let odometry = Odometry::new([1.5, -2.0, 0.1], [0.0, 0.0, 0.6, 0.8], Some(&covariance)).unwrap();
        let mut writer = Writer::default();
        odometry.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(Odometry::decode(&mut Reader::new(&bytes)), Ok(odometry));
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let not_finite = |field| Err(OdometryError::NotFinite { field });
        assert_eq!(Odometry::new([f64::NAN, 0.0, 0.0], NONE, None), not_finite("position"));
        assert_eq!(Odometry::new([0.0; 3], [0.0, 0.0, f64::INFINITY, 1.0], None), not_finite("orientation"));
        assert_eq!(Odometry::new([0.0; 3], [0.0; 4], None), Err(OdometryError::NotUnit { norm: 0.0 }));
        assert_eq!(Odometry::new([0.0; 3], NONE, Some(&[f64::NAN; 36])), not_finite("covariance"));
        let far = Odometry::new([0.0, -1.1e8, 0.0], NONE, None);
        assert_eq!(far, Err(OdometryError::TooFar { value: -1.1e8 }));
        let unsure = Odometry::new([0.0; 3], NONE, Some(&diagonal([1e13; 6])));
        assert_eq!(unsure, Err(OdometryError::TooUnsure { value: 1e13 }));
        let negative = diagonal([0.1, -0.1, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(Odometry::new([0.0; 3], NONE, Some(&negative)), Err(OdometryError::NotACovariance));
        let mut lopsided = diagonal([1.0; 6]);
        lopsided[1] = 0.5;
        assert_eq!(Odometry::new([0.0; 3], NONE, Some(&lopsided)), Err(OdometryError::NotACovariance));
    }

    #[test]
    fn an_unknown_motion_has_a_covariance_of_zero() {
        assert!(Odometry::new([0.0; 3], NONE, Some(&[0.0; 36])).is_ok());
    }
}
