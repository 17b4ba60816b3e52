//! Errors of calls and streams.

use std::error::Error as _;
use std::time::Duration;

use tonic::{Code, Status};

/// What went wrong. The message says what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The server's address is invalid.
    #[error(
        "`{endpoint}` is not the address of a server ({reason}); write it as HOST:PORT, http://HOST:PORT or https://HOST:PORT"
    )]
    Endpoint {
        /// The address as given.
        endpoint: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The token or the certificates cannot be used.
    #[error("{0}")]
    Options(String),
    /// The server was not reached, or the connection broke in the middle of a call.
    #[error(
        "no connection to {endpoint} ({reason}); check that waypost-server runs there and that the address is right"
    )]
    Connection {
        /// The address of the server.
        endpoint: String,
        /// What the network said.
        reason: String,
    },
    /// What answered is no server for robots.
    #[error(
        "what answers at this address does not speak gRPC; it may be the server's HTTP port, 7601 unless set otherwise: \
         give the one for robots, 7600 unless set otherwise"
    )]
    NotGrpc,
    /// The server refused. Its message says how to correct the request.
    #[error("{message}")]
    Status {
        /// The kind of refusal.
        code: Code,
        /// The server's message.
        message: String,
    },
    /// A stream could not be reopened within [`give_up_after`](crate::Reconnection::give_up_after).
    #[error(
        "lost the server for {} s with {unacknowledged} frames unacknowledged ({reason}); \
         once it is back, open the same session again and send them again",
        waited.as_secs()
    )]
    SessionLost {
        /// Frames of the session without an outcome.
        unacknowledged: usize,
        /// Time since the server last made progress.
        waited: Duration,
        /// The latest failure.
        reason: String,
    },
    /// The server came back without frames that it had acknowledged as durable.
    #[error(
        "the server had acknowledged frame {acknowledged} of this session, but now knows it only up to \
         {}; its data was replaced by older data: restore that, or start a new session",
        last_committed.map_or("no frame at all".to_owned(), |sequence| format!("frame {sequence}"))
    )]
    SessionRewound {
        /// The last frame that was acknowledged.
        acknowledged: u64,
        /// The last one that the server now knows.
        last_committed: Option<u64>,
    },
    /// The session has ended; [`Outcomes::next`](crate::Outcomes::next) says why.
    #[error("the session has ended, so frame {sequence} was not sent; see the last outcome for why")]
    SessionEnded {
        /// The frame that was not sent.
        sequence: u64,
    },
    /// Sequence numbers have to rise.
    #[error("frame {sequence} follows frame {last}; number frames so that every number is above the last")]
    SequenceNotRising {
        /// The number of the frame.
        sequence: u64,
        /// The number of the frame before.
        last: u64,
    },
    /// The data to upload could not be read; the server has changed nothing.
    #[error("cannot read what to upload: {0}")]
    Read(std::io::Error),
    /// The downloaded data could not be written.
    #[error("cannot write what was downloaded: {0}")]
    Write(std::io::Error),
    /// The server's response violates the contract.
    #[error("the server broke the protocol: {0}; use a server and a client of the same version")]
    Protocol(&'static str),
}

impl Error {
    /// The error of a call's status: from the server, or made here when the connection broke.
    pub(crate) fn from_status(status: &Status, endpoint: &str) -> Self {
        match broken_connection(status) {
            Some(reason) => Error::Connection { endpoint: endpoint.to_owned(), reason },
            None => Error::refused(status),
        }
    }

    /// The error of a status that the server sent.
    pub(crate) fn refused(status: &Status) -> Self {
        match status.message() {
            // The first byte of a message is a flag in gRPC, and `{` in the JSON of the other port.
            garbled if garbled.contains("invalid compression flag") => Error::NotGrpc,
            said => Error::Status { code: status.code(), message: said.to_owned() },
        }
    }
}

/// The reason, if the status was made here because the connection broke.
pub(crate) fn broken_connection(status: &Status) -> Option<String> {
    status.source().map(innermost)
}

/// The innermost cause, which comes from the operating system; the outer ones say "transport
/// error".
pub(crate) fn innermost(error: &(dyn std::error::Error + 'static)) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    cause.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_of_the_server_keeps_code_and_message() {
        let error = Error::from_status(&Status::not_found("no map `a`; create it"), "http://h:1");
        let Error::Status { code, message } = error else { panic!("{error:?}") };
        assert_eq!((code, message.as_str()), (Code::NotFound, "no map `a`; create it"));
    }

    #[test]
    fn the_port_for_people_is_no_server_for_robots() {
        let garbled =
            Status::internal("protocol error: received message with invalid compression flag: 123 …");
        assert!(matches!(Error::from_status(&garbled, "http://h:1"), Error::NotGrpc));
    }

    #[test]
    fn a_broken_connection_names_the_innermost_cause() {
        let cause = std::io::Error::new(std::io::ErrorKind::ConnectionReset, "reset by peer");
        let error = Error::from_status(&Status::from_error(Box::new(cause)), "http://h:1");
        assert!(matches!(&error, Error::Connection { reason, .. } if reason == "reset by peer"), "{error:?}");
    }
}
