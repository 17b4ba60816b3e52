//! The arguments of commands, one file each.

pub(crate) mod appearance;
pub(crate) mod navigate;
