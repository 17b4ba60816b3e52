//! Ways by looks: panoramas that have something in common are linked, and a robot is led from one
//! to the next.

pub mod epipolar;
pub mod graph;
pub mod navigator;
pub mod signature;
