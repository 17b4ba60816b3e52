//! One file per command.

pub mod load;
pub mod new_place;
pub mod sequence;
pub mod train;
