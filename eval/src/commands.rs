//! One file per command.

pub mod sequence;
pub mod train;
