//! Why bytes are not the value that they should be.

/// Why bytes are not the value they should be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The bytes end early.
    #[error("the data ends early: {needed} more bytes were expected; it was cut short, so fetch it again")]
    Truncated {
        /// Bytes missing.
        needed: usize,
    },
    /// The bytes do not begin as this format does.
    #[error("this is not a {expected} file; check which file was given")]
    Magic {
        /// What was expected, in words.
        expected: &'static str,
    },
    /// Written by a newer version of Waypost.
    #[error("written in format version {found}, this program reads up to {newest}; update Waypost")]
    Version {
        /// Version in the data.
        found: u32,
        /// Newest version that can be read.
        newest: u32,
    },
    /// The checksum does not agree with the content.
    #[error("the checksum does not match the content; the data is damaged, so fetch it again")]
    Checksum,
    /// A value that no writer produces.
    #[error("invalid content: {what}; the data is damaged or was not written by Waypost")]
    Invalid {
        /// What is wrong.
        what: String,
    },
    /// Content goes on after the value's end.
    #[error("{bytes} bytes follow the end of the content; the data is damaged")]
    Trailing {
        /// Bytes left over.
        bytes: usize,
    },
}

impl DecodeError {
    /// A [`DecodeError::Invalid`] that says `what`.
    pub fn invalid(what: impl std::fmt::Display) -> Self {
        Self::Invalid { what: what.to_string() }
    }
}
