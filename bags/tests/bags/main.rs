//! Bags that are written here and read back: whole, damaged and hostile.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs, unreachable_pub)]

mod choosing;
mod clocks;
mod hostile;
mod mutated;
mod reading;
mod rtabmap;
mod samples;
mod seeds;
mod writing;
