//! One file per command.

pub mod appearance;
pub mod calibrate;
pub mod compare;
pub mod load;
pub mod map;
pub mod merge;
pub mod navigate;
pub mod new_place;
pub mod posegraph;
pub mod scale;
pub mod sequence;
pub mod train;
pub mod train_scale;
pub mod visits;
