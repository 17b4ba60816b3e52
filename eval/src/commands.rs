//! One file per command.

pub(crate) mod appearance;
pub(crate) mod leave_one_out;
pub(crate) mod load;
pub(crate) mod map;
pub(crate) mod merge;
pub(crate) mod navigate;
pub(crate) mod posegraph;
pub(crate) mod recorded;
pub(crate) mod scale;
pub(crate) mod sequence;
pub(crate) mod soak;
pub(crate) mod train;
