//! Which way? Along a map by metres ([`metric`]) or by looks alone ([`appearance`]).
//!
//! Pure: no I/O, no clock, no pixels.

pub mod appearance;
pub mod metric;
