//! Metres: odometry, poses of one thing in the frame of another, how far wheels can be trusted, and
//! how far apart places are.

mod agreement;
mod odometry;
mod odometry_noise;
mod place_spacing;
mod relative_pose;
pub(crate) mod wheel_drift;
mod wheel_reach;

pub use agreement::{Agreement, AgreementVerdict, median};
pub use odometry::{Odometry, OdometryError};
pub(crate) use odometry::{decode_pose, encode_pose};
pub use odometry_noise::OdometryNoise;
pub use place_spacing::PlaceSpacing;
pub use relative_pose::{RelativePose, RelativePoseError};
pub(crate) use wheel_reach::WheelReach;
