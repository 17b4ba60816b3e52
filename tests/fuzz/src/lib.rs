//! Everything that strangers send, as targets that take any bytes. A fuzzer feeds them (`scripts/fuzz`), and so do tests that
//! need none (`tests/corpora`): what was kept of earlier runs, and mutations of it.
//!
//! A target fails by panicking: where the code that it feeds panics, and where what was taken does not come back from its own
//! encoding. How long it takes and how much memory is for whoever feeds it to judge.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a target fails by panicking")]

pub mod corpus;
pub mod memory;
pub mod mutation;
mod targets;

// The command line is a program, not a library: these files of it read what people write down.
#[allow(dead_code, reason = "the command line uses the rest")]
#[path = "../../../cli/src/camera_file.rs"]
mod camera_file;
#[allow(dead_code, reason = "the command line uses the rest")]
#[path = "../../../cli/src/file_stamps.rs"]
mod file_stamps;
#[allow(dead_code, reason = "the command line uses the rest")]
#[path = "../../../cli/src/odometry.rs"]
mod odometry;

pub use targets::{TARGETS, named};

/// What became of bytes that a target was fed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fed {
    /// They were what they should be, and came back from their own encoding as far as there is one.
    Taken,
    /// They were refused.
    Refused,
}

/// One kind of input.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name, which is that of its folder in `corpus/`.
    pub name: &'static str,
    /// Takes any bytes. Panics if something is wrong with the code.
    pub feed: fn(&[u8]) -> Fed,
}
