//! How are places joined? The map as a pure fold of its log, and the story of one frame.
//!
//! Pure: no I/O, no async, no pixels. Begin with [`mapper`], which tells the story.

pub mod appearance_graph;
pub mod appearance_navigation;
pub mod budget;
pub mod checkpoint;
pub mod epipolar;
pub mod event;
pub mod g2o;
pub mod map;
pub mod mapper;
pub mod merging;
pub mod motion;
pub mod navigation;
pub mod odometry;
pub mod odometry_prior;
pub mod place_poses;
mod rebased;
pub mod relative_pose;
pub mod relaxation;
pub mod retelling;
pub mod standing;
pub mod trajectory;
pub mod verification;
mod wheel_drift;
