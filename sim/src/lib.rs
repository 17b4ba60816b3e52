//! Worlds to drive in, before one has a robot, and to measure in, because the truth is known.
//!
//! A [`floor_plan::FloorPlan`] says where walls and furniture are; [`worlds`] has some drawn. A
//! [`scene::Scene`] is a plan with its surfaces painted, and renders what a camera on a robot sees.
//! Everything depends on seeds alone: the same seeds give the same bits on any number of threads.
//! Conventions are REP-103's: x forward, y left, z up; metres, radians.

pub mod camera;
pub mod drawing;
pub mod drive;
pub mod floor_plan;
pub mod image;
pub mod light;
pub mod link;
pub mod people;
pub mod pose;
mod random;
pub mod range;
pub mod range_sensor;
pub mod render;
mod rigs;
pub mod robot;
pub mod route;
pub mod scene;
pub mod simulation;
pub mod texture;
pub mod worlds;
