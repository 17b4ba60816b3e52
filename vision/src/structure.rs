//! How far features are, by the robot's own motion, and where a robot stands that sees them again.
//!
//! [`Tracker`] gives the features of a frame depths: each is matched to the frame before,
//! wheels say how far the camera moved in between, and an inverse-depth filter carries on what
//! earlier frames knew (J. Civera, A. Davison & J. Montiel, Inverse depth parametrization for
//! monocular SLAM, IEEE T-RO 24(5), 2008). `locate` finds the planar motion that takes a returning
//! robot's view to features of known depth, in metres and with its covariance.
//!
//! Robots drive on a floor: what is found is x, y and heading. The camera may sit on the robot
//! wherever it is declared to.

mod depths;
mod locating;
mod motion;
mod nodding;
mod resection;
mod robot_camera;
mod tracker;
mod turning;

pub(crate) use locating::{Located, Locating, Sight, locate};
pub use robot_camera::RobotCamera;
pub use tracker::{TrackedFrame, Tracker};
