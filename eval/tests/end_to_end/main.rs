//! The built program, run as people run it.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers included")]

mod appearance;
mod comparing;
mod errors;
mod mapping;
mod navigating;
mod new_place;
mod posegraph;
mod real_data;
mod scale;
mod synthetic;
mod tool;
