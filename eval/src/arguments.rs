//! The command line, command by command.

pub(crate) mod merge;
