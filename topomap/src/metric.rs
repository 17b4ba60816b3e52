//! Metres: odometry, poses of one thing in the frame of another, and how far wheels can be trusted.

mod odometry;
mod odometry_noise;
mod relative_pose;
pub(crate) mod wheel_drift;

pub use odometry::{Odometry, OdometryError};
pub(crate) use odometry::{decode_pose, encode_pose};
pub use odometry_noise::OdometryNoise;
pub use relative_pose::{RelativePose, RelativePoseError};
