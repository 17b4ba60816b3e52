//! Waypost from the outside: real servers on ports of their own, the real client, real images.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod harness;

mod appearance_navigation;
mod appearance_ways;
mod bad_frames;
mod bad_requests;
mod bad_sessions;
mod bad_table;
mod checkpoints;
mod command_line;
mod config;
mod connections;
mod decisions;
mod dependencies;
mod disk_full;
mod explain;
mod frames;
mod jobs;
mod kill;
mod licences;
mod load;
mod localize;
mod mapping;
mod merging;
mod navigation;
mod openapi;
mod operations;
mod overload;
mod pictures;
mod places;
mod queries;
mod rebind;
mod resend;
mod rest;
mod rest_exports;
mod rest_parity;
mod restore;
mod shutdown;
mod snapshots;
mod startup;
mod tls;
mod tokens;
mod training;
mod verification;
mod words;
