//! One file per command.

pub(crate) mod demo;
pub(crate) mod job;
pub(crate) mod map;
pub(crate) mod model;
pub(crate) mod stream;
