//! How a command fails, in words for the person at the keyboard.

use std::fmt::Display;

use anyhow::anyhow;

/// The command line asks for what cannot be. The program's exit code is 2 then, and 1 after any other failure.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Refused(String);

/// For `map_err` of what another command line would mend.
pub(crate) fn refused(reason: impl Display) -> anyhow::Error {
    Refused(reason.to_string()).into()
}

/// For `map_err` of what cannot fail unless the program is wrong.
pub(crate) fn fault(reason: impl Display) -> anyhow::Error {
    anyhow!("{reason}; this is a fault of Waypost, please report it")
}
