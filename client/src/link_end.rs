//! Why a stream ended, and whether another attempt is worth it.

use tonic::{Code, Status};

use crate::error::{Error, broken_connection};

/// How a link came to its end.
pub(crate) enum LinkEnd {
    /// Worth another attempt.
    Broken(String),
    Final(Error),
}

impl LinkEnd {
    /// A stream that ended with a status.
    pub(crate) fn of(status: &Status) -> Self {
        if let Some(reason) = broken_connection(status) {
            return LinkEnd::Broken(reason);
        }
        match status.code() {
            // UNKNOWN stands for a stream that was cut off without a status, as by a server that dies.
            Code::Unavailable
            | Code::ResourceExhausted
            | Code::DeadlineExceeded
            | Code::Cancelled
            | Code::Unknown => LinkEnd::Broken(status.message().to_owned()),
            Code::Aborted
            | Code::NotFound
            | Code::FailedPrecondition
            | Code::InvalidArgument
            | Code::PermissionDenied
            | Code::Unauthenticated
            | Code::AlreadyExists
            | Code::OutOfRange
            | Code::Unimplemented
            | Code::Internal
            | Code::DataLoss
            | Code::Ok => LinkEnd::Final(Error::refused(status)),
        }
    }
}
