//! Why the bridge ended.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use waypost_client::Error;

use crate::bus::BusError;
use crate::given::SettingsError;
use crate::peers::PeersError;
use crate::robot_words::SessionError;
use crate::viewers::ViewersError;

/// Why the bridge ended. The message says what to do about it.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// It was told what does not fit.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// DDS.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Named peers.
    #[error(transparent)]
    Peers(#[from] PeersError),
    /// Foxglove's app cannot be let in.
    #[error(transparent)]
    Viewers(#[from] ViewersError),
    /// The server refuses for good.
    #[error(transparent)]
    Server(#[from] Error),
    /// Words cannot be made.
    #[error("{0}")]
    Words(String),
    /// A certificate.
    #[error("cannot read {}: {source}", path.display())]
    Certificate {
        /// Its file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Threads or signals.
    #[error("the system refuses what the bridge needs: {0}")]
    System(#[from] io::Error),
    /// A part of the bridge died.
    #[error("a part of the bridge ended by itself; the lines above say why; please report it")]
    Died,
}

impl From<SessionError> for Failure {
    fn from(error: SessionError) -> Self {
        match error {
            SessionError::Server(error) => Self::Server(error),
            SessionError::Words(_) => Self::Words(error.to_string()),
        }
    }
}

impl Failure {
    /// 2 for wrong usage, 3 for a server that was lost, 4 for one that refuses, else 1: as `waypost` has them.
    pub(crate) fn exit_code(&self) -> ExitCode {
        let code = match self {
            Failure::Settings(_) | Failure::Peers(PeersError::Unknown { .. }) => 2,
            Failure::Server(Error::Connection { .. } | Error::NotGrpc | Error::SessionLost { .. }) => 3,
            Failure::Server(Error::Status { .. } | Error::SessionRewound { .. }) => 4,
            Failure::Server(_)
            | Failure::Words(_)
            | Failure::Bus(_)
            | Failure::Viewers(_)
            | Failure::Certificate { .. } => 1,
            Failure::Peers(PeersError::NoPort { .. } | PeersError::System(_)) => 1,
            Failure::System(_) | Failure::Died => 1,
        };
        ExitCode::from(code)
    }
}
