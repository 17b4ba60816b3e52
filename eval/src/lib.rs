//! How good is it? Models trained and sequences run in process, and what comes out measured.
//!
//! [`commands`] has one file per command of the `waypost-eval` program, each a story told by its
//! first function. A [`dataset`] is streamed once, in order, through a [`ranking`]; its proposals
//! are judged against the truth and swept into [`precision_recall`].

pub mod calibration;
pub mod choices;
pub mod commands;
pub mod dataset;
pub mod error;
pub mod event_log;
pub mod false_pictures;
pub mod files;
pub mod match_matrix;
pub mod memory;
pub mod plots;
pub mod precision_recall;
pub mod progress;
pub mod ranking;
pub mod timing;
pub mod workload;
