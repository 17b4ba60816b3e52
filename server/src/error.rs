//! What a request can come to, besides success.

use std::time::Duration;

use topomap::ids::FrameId;
use topomap::mapper::FrameError;

use crate::camera::CameraError;
use crate::quotas::OverQuota;
use crate::storage::{StorageError, StoredError};

/// After which a database that is held up may be free again.
const HELD_UP_RETRY: Duration = Duration::from_secs(2);

/// Why a request was not served. The message is for the one who asked and says how to mend it; what
/// only the operator can mend is logged where it happened.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ServiceError {
    /// The request itself is wrong and will stay so.
    #[error("{message}")]
    InvalidArgument {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// What it names does not exist.
    #[error("{message}")]
    NotFound {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// What it would make is there already.
    #[error("{message}")]
    AlreadyExists {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// It is right, but not now.
    #[error("{message}")]
    FailedPrecondition {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// Another request took its place, or the log that it goes on in is no longer there.
    #[error("{message}")]
    Aborted {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// It would take more than there is.
    #[error("{message}")]
    ResourceExhausted {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// A quota is used up for now, or until somebody makes room; the same request may succeed then.
    #[error("{message}")]
    QuotaUsedUp {
        /// Which quota, of whom, what there is of it, and what to do.
        message: String,
        /// How long to wait before.
        retry_after: Duration,
    },
    /// The same request may succeed a little later.
    #[error("{message}")]
    Unavailable {
        /// What is wrong and how to mend it.
        message: String,
        /// How long to wait before, where that is known.
        retry_after: Option<Duration>,
    },
    /// Who asks is not known.
    #[error("{message}")]
    Unauthenticated {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// Who asks is known, and may not.
    #[error("{message}")]
    PermissionDenied {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// It took too long.
    #[error("{message}")]
    DeadlineExceeded {
        /// What is wrong and how to mend it.
        message: String,
    },
    /// What was stored is damaged.
    #[error("{message}")]
    DataLoss {
        /// What is damaged, and how to mend it.
        message: String,
    },
    /// The server is at fault.
    #[error("the server failed on this request; its log says more")]
    Internal,
}

impl ServiceError {
    pub(crate) fn invalid(message: impl std::fmt::Display) -> Self {
        Self::InvalidArgument { message: message.to_string() }
    }

    pub(crate) fn not_found(message: impl std::fmt::Display) -> Self {
        Self::NotFound { message: message.to_string() }
    }

    pub(crate) fn precondition(message: impl std::fmt::Display) -> Self {
        Self::FailedPrecondition { message: message.to_string() }
    }

    pub(crate) fn aborted(message: impl std::fmt::Display) -> Self {
        Self::Aborted { message: message.to_string() }
    }

    pub(crate) fn unavailable(message: impl std::fmt::Display) -> Self {
        Self::Unavailable { message: message.to_string(), retry_after: None }
    }

    /// More is asked for than can be done now.
    pub(crate) fn overloaded(retry_after: Duration) -> Self {
        let message = format!(
            "the server has more images waiting than it can work off; send this one again in {:.1} s, or send fewer",
            retry_after.as_secs_f64()
        );
        Self::Unavailable { message, retry_after: Some(retry_after) }
    }

    pub(crate) fn unauthenticated(message: impl std::fmt::Display) -> Self {
        Self::Unauthenticated { message: message.to_string() }
    }

    pub(crate) fn deadline(message: impl std::fmt::Display) -> Self {
        Self::DeadlineExceeded { message: message.to_string() }
    }

    /// When to ask again, where that is known.
    pub(crate) fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Unavailable { retry_after, .. } => *retry_after,
            Self::QuotaUsedUp { retry_after, .. } => Some(*retry_after),
            Self::InvalidArgument { .. }
            | Self::NotFound { .. }
            | Self::AlreadyExists { .. }
            | Self::FailedPrecondition { .. }
            | Self::Aborted { .. }
            | Self::ResourceExhausted { .. }
            | Self::Unauthenticated { .. }
            | Self::PermissionDenied { .. }
            | Self::DeadlineExceeded { .. }
            | Self::DataLoss { .. }
            | Self::Internal => None,
        }
    }

    /// Whether it may succeed later as it is: a frame is to be sent again then, before those behind it.
    pub(crate) fn is_for_now(&self) -> bool {
        matches!(self, Self::Unavailable { .. } | Self::QuotaUsedUp { .. })
    }

    /// Its kind in one word, as REST and the metrics call it.
    pub(crate) fn code_name(&self) -> &'static str {
        match self {
            Self::InvalidArgument { .. } => "invalid_argument",
            Self::NotFound { .. } => "not_found",
            Self::AlreadyExists { .. } => "already_exists",
            Self::FailedPrecondition { .. } => "failed_precondition",
            Self::Aborted { .. } => "aborted",
            Self::ResourceExhausted { .. } | Self::QuotaUsedUp { .. } => "resource_exhausted",
            Self::Unavailable { .. } => "unavailable",
            Self::Unauthenticated { .. } => "unauthenticated",
            Self::PermissionDenied { .. } => "permission_denied",
            Self::DeadlineExceeded { .. } => "deadline_exceeded",
            Self::DataLoss { .. } => "data_loss",
            Self::Internal => "internal",
        }
    }

    /// A fault of the server: `cause` goes to the log, not to the user.
    pub(crate) fn internal(cause: impl std::fmt::Display) -> Self {
        tracing::error!(%cause, "internal error");
        Self::Internal
    }

    /// There is no room left: `cause` goes to the log.
    pub(crate) fn disk_full(cause: impl std::fmt::Display) -> Self {
        tracing::error!(%cause, "disk full");
        Self::unavailable(
            "the server's disk is full and nothing was stored; free some space there, then send again",
        )
    }

    /// The database is held up, or failed this once: `cause` goes to the log.
    pub(crate) fn held_up(cause: impl std::fmt::Display) -> Self {
        tracing::warn!(%cause, "the database is held up");
        let message = format!(
            "the server's database is held up and nothing was stored; send again in {} s",
            HELD_UP_RETRY.as_secs()
        );
        Self::Unavailable { message, retry_after: Some(HELD_UP_RETRY) }
    }

    /// What was asked for is not as it was written, and is not handed out. Where it is was logged as it was found.
    pub(crate) fn damaged(found: &str) -> Self {
        let message = format!(
            "{found}; it is damaged on the server's disk and not handed out. `waypost-server check --deep` tells all \
             that is damaged; bring it back from a snapshot or a backup"
        );
        Self::DataLoss { message }
    }

    /// The same of a model, which no snapshot of a map holds.
    fn damaged_model(cause: &StorageError) -> Self {
        tracing::error!(%cause, "damage on the disk");
        let message = format!(
            "{cause}; it is damaged on the server's disk and not handed out. A backup has it, or the database of another \
             server that it was imported into"
        );
        Self::DataLoss { message }
    }

    /// A later stream of the same robot goes on in place of this one.
    pub(crate) fn taken_over() -> Self {
        Self::Aborted { message: "a later stream took this session over; this one is closed".to_owned() }
    }

    /// The server is going down in good order.
    pub(crate) fn stopping() -> Self {
        Self::unavailable(
            "the server is stopping; connect again in a moment and send what was not acknowledged",
        )
    }
}

impl From<StorageError> for ServiceError {
    fn from(error: StorageError) -> Self {
        match error {
            StorageError::DiskFull(_) => Self::disk_full(error),
            StorageError::HeldUp(_) | StorageError::MediaHeldUp { .. } | StorageError::TakenOver => {
                Self::held_up(error)
            }
            StorageError::Rot(found) => Self::damaged(&found),
            StorageError::DamagedModel { .. } => Self::damaged_model(&error),
            StorageError::ReadOnly(_) => Self::precondition(error),
            StorageError::Abandoned => Self::aborted(error),
            StorageError::Retold => Self::Aborted { message: format!("{error}; ask again") },
            StorageError::NoText => Self::invalid(error),
            StorageError::OverQuota(over) => over.into(),
            StorageError::Exists
            | StorageError::InUse
            | StorageError::JobEnded
            | StorageError::Directory { .. }
            | StorageError::NothingThere { .. }
            | StorageError::Locked { .. }
            | StorageError::Newer { .. }
            | StorageError::NoDatabase { .. }
            | StorageError::Damaged(_)
            | StorageError::Broken { .. }
            | StorageError::Failed(_)
            | StorageError::Owned { .. }
            | StorageError::Unfit(_)
            | StorageError::Migration(_) => Self::internal(error),
        }
    }
}

impl From<OverQuota> for ServiceError {
    fn from(OverQuota { quota: _, holder: _, message, retry_after }: OverQuota) -> Self {
        match retry_after {
            Some(retry_after) => Self::QuotaUsedUp { message, retry_after },
            None => Self::FailedPrecondition { message },
        }
    }
}

impl From<CameraError> for ServiceError {
    fn from(error: CameraError) -> Self {
        Self::invalid(error)
    }
}

impl From<ServiceError> for StoredError {
    fn from(error: ServiceError) -> Self {
        Self { code: error.code_name().to_owned(), message: error.to_string() }
    }
}

impl From<StoredError> for ServiceError {
    fn from(StoredError { code, message }: StoredError) -> Self {
        match code.as_str() {
            "invalid_argument" => Self::InvalidArgument { message },
            "not_found" => Self::NotFound { message },
            "already_exists" => Self::AlreadyExists { message },
            "failed_precondition" => Self::FailedPrecondition { message },
            "resource_exhausted" => Self::ResourceExhausted { message },
            "unavailable" => Self::Unavailable { message, retry_after: None },
            "unauthenticated" => Self::Unauthenticated { message },
            "permission_denied" => Self::PermissionDenied { message },
            "deadline_exceeded" => Self::DeadlineExceeded { message },
            "data_loss" => Self::DataLoss { message },
            "internal" => Self::Internal,
            _aborted_or_of_a_later_server => Self::Aborted { message },
        }
    }
}

impl From<FrameError> for ServiceError {
    fn from(error: FrameError) -> Self {
        match error {
            FrameError::UnknownSession { .. } => Self::not_found(error),
            FrameError::SequenceNotRising { .. } | FrameError::StampNotRising { .. } => {
                Self::precondition(error)
            }
            FrameError::OdometryJump { .. }
            | FrameError::OdometryStandsStill { .. }
            | FrameError::ForeignWord { .. } => Self::invalid(error),
        }
    }
}

/// A stored frame could not be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum ArchiveError {
    /// Now; later it may be.
    #[error("frame {frame} of the map could not be read back: {why}; send the frame again")]
    NotNow {
        /// The frame.
        frame: FrameId,
        /// What happened.
        why: String,
    },
    /// What is stored of it is not what was written: that does not mend by asking again.
    #[error("{0}")]
    Damaged(String),
}

impl ArchiveError {
    /// Why `frame` could not be read.
    pub(crate) fn of(frame: FrameId, error: StorageError) -> Self {
        match error {
            StorageError::Rot(found) => Self::Damaged(found),
            error => Self::NotNow { frame, why: error.to_string() },
        }
    }
}

impl From<ArchiveError> for ServiceError {
    fn from(error: ArchiveError) -> Self {
        match error {
            ArchiveError::NotNow { .. } => Self::unavailable(error),
            ArchiveError::Damaged(found) => Self::damaged(&found),
        }
    }
}
