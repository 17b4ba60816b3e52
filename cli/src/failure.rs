//! Errors of commands: their messages and exit codes.

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use waypost_bags::rtabmap::RtabError;
use waypost_bags::{BagError, ChoiceError};
use waypost_client::launch::LaunchError;
use waypost_client::{Code, Error};

use crate::camera_file::CameraFileError;
use crate::images::{ListingError, VideoError};
use crate::odometry::OdometryError;
use crate::truth::TruthError;

/// Ends the help of every command.
pub(crate) const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed
  2  wrong usage
  3  the server was not reached, or was lost
  4  the server refused: not found, invalid, in use, …
  5  streamed to the end, but some frames were refused";

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    #[error(transparent)]
    Client(#[from] Error),
    #[error(transparent)]
    Images(#[from] ListingError),
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error(transparent)]
    Database(#[from] RtabError),
    #[error(transparent)]
    Camera(#[from] CameraFileError),
    #[error("{}: {source}", path.display())]
    Topics { path: PathBuf, source: ChoiceError },
    #[error("{}: {source}", path.display())]
    Odometry { path: PathBuf, source: OdometryError },
    #[error("{}: {source}", path.display())]
    Truth { path: PathBuf, source: TruthError },
    #[error("cannot {action} {}: {source}", path.display())]
    File { action: &'static str, path: PathBuf, source: io::Error },
    /// An argument does not fit the files, the map or the other arguments.
    #[error("{0}")]
    Unfit(String),
    /// The server has no such thing.
    #[error("{0}")]
    NotThere(String),
    /// The server refused a goal after it had been set: no way leads there from where the robot is.
    #[error("{0}")]
    GoalRefused(String),
    #[error("{0}")]
    JobFailed(String),
    #[error("{0}")]
    Interrupted(String),
    #[error("{refused} of {frames} frames were refused; the messages above say why")]
    FramesRefused { refused: usize, frames: usize },
    #[error("the server of the demo {}\n{}", .0.problem, .0.log)]
    DemoServer(#[from] LaunchError),
    #[error("no right loop closure was found; the model or the sequence is not the one that ships")]
    DemoWithoutClosure,
    #[error("cannot write to stdout: {0}")]
    Stdout(io::Error),
    #[error("cannot start the asynchronous runtime: {0}")]
    Runtime(io::Error),
}

impl Failure {
    /// For `map_err` of file operations.
    pub(crate) fn file(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Failure {
        let path = path.to_owned();
        move |source| Failure::File { action, path, source }
    }

    /// Whether the reader of stdout has closed it, as in `waypost map ls | head -1`.
    pub(crate) fn is_closed_stdout(&self) -> bool {
        matches!(self, Failure::Stdout(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }

    /// The option that helps, which the library's error cannot name.
    pub(crate) fn hint(&self) -> &'static str {
        match self {
            Failure::Client(Error::Connection { endpoint, reason }) => connection_hint(endpoint, reason),
            _ => "",
        }
    }

    pub(crate) fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Failure::Client(error) => client_exit_code(error),
            Failure::NotThere(_) | Failure::GoalRefused(_) => 4,
            Failure::FramesRefused { .. } => 5,
            Failure::Images(_)
            | Failure::Video(_)
            | Failure::Bag(_)
            | Failure::Database(_)
            | Failure::Camera(_)
            | Failure::Topics { .. }
            | Failure::Odometry { .. }
            | Failure::Truth { .. }
            | Failure::File { .. }
            | Failure::Unfit(_)
            | Failure::JobFailed(_)
            | Failure::Interrupted(_)
            | Failure::DemoServer(_)
            | Failure::DemoWithoutClosure
            | Failure::Stdout(_)
            | Failure::Runtime(_) => 1,
        })
    }
}

/// What HTTP/2 without TLS hears from a listener that speaks TLS, or asks for a certificate. Which of
/// these it is hangs on whether the connection was written to or read first.
const BROKEN_OFF: [&str; 5] = [
    "frame with invalid size",
    "broken pipe",
    "connection closed",
    "connection was not ready",
    "reset by peer",
];

fn connection_hint(endpoint: &str, reason: &str) -> &'static str {
    if reason.contains("received fatal alert") {
        "\nthe server refused how this program presents itself: give --client-cert and --client-key that its authority issued"
    } else if reason.to_lowercase().contains("certificate") {
        "\nname the authority of the server's certificate with --ca or WAYPOST_CA; \
         if the server asks for one of yours, give --client-cert and --client-key"
    } else if reason.contains("InvalidContentType") {
        "\nthat server speaks no TLS: name it with http://, or have it started with a certificate"
    } else if endpoint.starts_with("https://") {
        "\ncheck that it runs; if it asks for a certificate of yours, give --client-cert and --client-key"
    } else if BROKEN_OFF.iter().any(|said| reason.to_lowercase().contains(said)) {
        "\nthat server may speak TLS: name it with https://"
    } else {
        "\nstart a server with `waypost-server`, or name another with --server or WAYPOST_SERVER"
    }
}

fn client_exit_code(error: &Error) -> u8 {
    match error {
        Error::Endpoint { .. } | Error::Options(_) => 2,
        Error::Connection { .. } | Error::NotGrpc | Error::SessionLost { .. } => 3,
        Error::Status { code, .. } => match code {
            Code::Unavailable | Code::DeadlineExceeded => 3,
            Code::Internal | Code::Unknown | Code::DataLoss | Code::Cancelled | Code::Ok => 1,
            Code::InvalidArgument
            | Code::NotFound
            | Code::AlreadyExists
            | Code::PermissionDenied
            | Code::ResourceExhausted
            | Code::FailedPrecondition
            | Code::Aborted
            | Code::OutOfRange
            | Code::Unimplemented
            | Code::Unauthenticated => 4,
        },
        Error::SessionRewound { .. }
        | Error::SessionEnded { .. }
        | Error::SequenceNotRising { .. }
        | Error::Read(_)
        | Error::Write(_)
        | Error::Protocol(_) => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::connection_hint;

    /// Under load a connection of the wrong kind ends in one of several ways.
    #[test]
    fn the_hint_fits_the_scheme_however_the_connection_ended() {
        for reason in
            ["stream closed because of a broken pipe", "connection closed", "Connection was not ready"]
        {
            assert!(connection_hint("http://h:1", reason).contains("may speak TLS"), "{reason}");
            assert!(connection_hint("https://h:1", reason).contains("--client-cert"), "{reason}");
        }
        assert!(
            connection_hint("http://h:1", "Connection refused (os error 111)").contains("`waypost-server`")
        );
        for alert in ["UnknownCA", "CertificateRequired", "BadCertificate"] {
            let hint = connection_hint("https://h:1", &format!("received fatal alert: {alert}"));
            assert!(hint.contains("--client-cert") && !hint.contains("--ca"), "{hint}");
        }
        assert!(connection_hint("https://h:1", "invalid peer certificate").contains("--ca"));
        assert!(connection_hint("https://h:1", "InvalidContentType").contains("http://"));
    }
}
