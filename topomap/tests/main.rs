//! Maps from the outside: drives through worlds that words tell apart, in one binary.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers included")]

mod building;
mod closing;
mod correcting;
mod driven_on;
mod drives;
mod fold;
mod golden;
mod look_alikes;
mod merging;
mod metric;
mod metric_logs;
mod one_motion;
mod one_threshold;
mod past_closures;
mod reach;
mod rewriting;
mod rounds;
mod sight;
mod staying;
mod transcript;
mod trimming;
mod verification;
mod verification_settings;
mod words;
