//! The built program, run as people run it.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers included")]

mod appearance;
mod calibrating;
mod errors;
mod mapping;
mod navigating;
mod posegraph;
mod real_data;
mod scale;
mod synthetic;
mod tool;
