//! What can be wrong with settings.

use std::net::SocketAddr;
use std::path::PathBuf;

use super::keys::names;

/// What is wrong with the settings.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error(
        "cannot read the settings in {path}: {reason}; name another file with --config or WAYPOST_CONFIG"
    )]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The file has a key that means nothing.
    #[error("{path} has the unknown key `{key}`; known are {}", names())]
    UnknownKey {
        /// The file.
        path: PathBuf,
        /// The key.
        key: String,
    },
    /// A value is of no use.
    #[error("{key} ({origin}) cannot be used: {reason}; write {form}")]
    Value {
        /// The key.
        key: String,
        /// Where it was set.
        origin: String,
        /// What is wrong.
        reason: String,
        /// How to write it.
        form: &'static str,
    },
    /// A setting lacks one that it needs.
    #[error("{key} ({origin}) needs {missing}, which is not set; set both, or neither")]
    Lacks {
        /// The key.
        key: &'static str,
        /// Where it was set.
        origin: String,
        /// The other key.
        missing: &'static str,
    },
    /// Robots and people were sent to one port.
    #[error(
        "http_address ({origin}) is {address}, and so is grpc_address; they are two listeners, so give them different \
         ports, or port 0 for free ones"
    )]
    SameAddress {
        /// Where http_address was set.
        origin: String,
        /// The address.
        address: SocketAddr,
    },
}
