#![doc = include_str!("../README.md")]

pub mod g2o;
mod graph;
mod planar;
mod pose;
mod relaxation;
pub mod shortest_paths;
pub mod trajectory;

pub use graph::{Edge, EdgeError, EdgeKind, MissingPose, PlanarGraph, PoseGraph, SpatialGraph};
pub use planar::PlanarPose;
pub use pose::{Linearized, Pose};
pub use relaxation::{Closures, RelaxationSettings, Relaxed, Start, relax};
