//! One file per command.

pub mod load;
pub mod sequence;
pub mod train;
