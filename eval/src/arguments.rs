//! The arguments of commands, one file each; `system` and `values` are what several share.

pub(crate) mod appearance;
pub(crate) mod calibrate;
pub(crate) mod compare;
pub(crate) mod load;
pub(crate) mod map;
pub(crate) mod merge;
pub(crate) mod navigate;
pub(crate) mod new_place;
pub(crate) mod posegraph;
pub(crate) mod scale;
pub(crate) mod sequence;
pub(crate) mod system;
pub(crate) mod train;
pub(crate) mod train_scale;
pub(crate) mod values;
pub(crate) mod visits;
