//! Waypost from the outside: real servers on ports of their own, the real client, real images.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod harness;

mod bad_frames;
mod bad_requests;
mod bad_sessions;
mod command_line;
mod decisions;
mod dependencies;
mod disk_full;
mod kill;
mod licences;
mod resend;
mod rest;
mod restore;
mod shutdown;
mod startup;
mod training;
