//! Where structure puts the robot.

use fabmap::codec::{DecodeError, Reader, Writer};

use crate::metric::RelativePose;

/// What features of known depth say of where the robot was at the current frame, seen from where it
/// was at the earlier one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Placement {
    /// Nothing: the camera or the wheels are not known, or too few of the features that look alike
    /// have a depth.
    #[default]
    Unknown,
    /// Enough of them do, and there is no pose that they agree on.
    Nowhere,
    /// There.
    At {
        /// Pose of `base_link` at the current frame in that of the earlier one, as solved.
        pose: RelativePose,
        /// Features that agree with it.
        inliers: u32,
    },
}

const UNKNOWN: u8 = 0;
const NOWHERE: u8 = 1;
const AT: u8 = 2;

impl Placement {
    /// Metres from the earlier frame to the current one, if it is known where that is.
    #[must_use]
    pub fn distance_m(&self) -> Option<f64> {
        match self {
            Placement::At { pose, .. } => Some(pose.pose().x_m().hypot(pose.pose().y_m())),
            Placement::Unknown | Placement::Nowhere => None,
        }
    }

    /// Features of known depth that agree where the robot is.
    #[must_use]
    pub fn inliers(&self) -> u32 {
        match self {
            Placement::At { inliers, .. } => *inliers,
            Placement::Unknown | Placement::Nowhere => 0,
        }
    }

    pub(super) fn encode(&self, writer: &mut Writer) {
        match self {
            Placement::Unknown => writer.u8(UNKNOWN),
            Placement::Nowhere => writer.u8(NOWHERE),
            Placement::At { pose, inliers } => {
                writer.u8(AT);
                pose.encode(writer);
                writer.varint(u64::from(*inliers));
            }
        }
    }

    pub(super) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        match reader.u8()? {
            UNKNOWN => Ok(Placement::Unknown),
            NOWHERE => Ok(Placement::Nowhere),
            AT => {
                let pose = RelativePose::decode(reader)?;
                Ok(Placement::At { pose, inliers: reader.varint_u32()? })
            }
            other => Err(DecodeError::invalid(format_args!("placement {other}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use posegraph::PlanarPose;

    use super::*;
    use crate::evidence::{Candidate, Quantity, TwoView, VerificationSettings};
    use crate::metric::PlaceSpacing;

    /// What structure measures in metres takes the place of what the image plane bounds.
    #[test]
    fn metres_decide_where_they_are_known() {
        let settings = VerificationSettings::default();
        let spacing = PlaceSpacing { distance_m: 0.8, angle_rad: 0.1 };
        let at = |x_m: f64, heading_rad: f64, inliers: u32| {
            let covariance = Matrix3::from_diagonal_element(1e-4);
            let pose = RelativePose::new(PlanarPose::new(x_m, 0.0, heading_rad), covariance).unwrap();
            Placement::At { pose, inliers }
        };
        let failed = |placement| {
            let shifted = Candidate::shifted(0.0, 0.7).view.unwrap();
            let view = TwoView { placement, ..shifted };
            let checks = settings.of_one_place(&view, &spacing);
            checks.iter().filter(|check| !check.passed()).map(|check| check.quantity).collect::<Vec<_>>()
        };
        assert_eq!(failed(Placement::Unknown), [Quantity::TranslationWidths]);
        assert_eq!(failed(at(1.59, 0.52, 16)), []);
        assert_eq!(failed(at(-1.61, 0.0, 16)), [Quantity::DistanceM]);
        assert_eq!(failed(at(0.0, -0.53, 16)), [Quantity::HeadingRad]);
        assert_eq!(failed(at(0.0, 0.0, 15)), [Quantity::PlacedInliers]);
        assert_eq!(failed(Placement::Nowhere), [Quantity::PlacedInliers]);
    }
}
