//! Why a stream ended, and whether another attempt is worth it.

use std::time::Duration;

use tokio::time::timeout;
use tonic::{Code, Status};

use crate::error::{Error, broken_connection};

/// How a link came to its end.
pub(crate) enum LinkEnd {
    /// Worth another attempt.
    Broken(String),
    Final(Error),
}

/// Opening a large map takes a server seconds.
const OPENING_TIMEOUT: Duration = Duration::from_secs(30);

/// What the server answers to the opening of `what`, if it does so in time.
pub(crate) async fn opened<T>(
    what: &str,
    opening: impl Future<Output = Result<T, Status>>,
) -> Result<T, LinkEnd> {
    match timeout(OPENING_TIMEOUT, opening).await {
        Ok(answered) => answered.map_err(|status| LinkEnd::of(&status)),
        Err(_elapsed) => {
            let waited_s = OPENING_TIMEOUT.as_secs();
            Err(LinkEnd::Broken(format!("it did not open the {what} within {waited_s} s")))
        }
    }
}

impl LinkEnd {
    /// A stream that ended without a word.
    pub(crate) fn closed() -> Self {
        LinkEnd::Broken("it closed the stream".to_owned())
    }

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
