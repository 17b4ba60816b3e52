//! One file per command.

pub(crate) mod closure;
pub(crate) mod cluster;
pub(crate) mod demo;
pub(crate) mod explain;
pub(crate) mod import;
pub(crate) mod inspect;
pub(crate) mod job;
pub(crate) mod map;
pub(crate) mod merge;
pub(crate) mod model;
pub(crate) mod navigate;
pub(crate) mod query;
pub(crate) mod refusals;
pub(crate) mod session;
pub(crate) mod shell;
pub(crate) mod simulate;
pub(crate) mod snapshot;
pub(crate) mod stream;
pub(crate) mod token;
