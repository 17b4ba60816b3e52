//! The arguments of commands, one file each.

pub(crate) mod appearance;
pub(crate) mod merge;
pub(crate) mod navigate;
