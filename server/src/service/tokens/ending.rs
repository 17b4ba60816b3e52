//! When what a token let in has to end, and why.

use std::sync::{Arc, OnceLock};

use tokio_util::sync::CancellationToken;

use crate::error::ServiceError;

/// The end of what was let in by a secret, or without one. Cheap to clone; all clones end together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ending {
    over: CancellationToken,
    why: Arc<OnceLock<ServiceError>>,
}

impl Ending {
    pub(super) fn end(&self, why: ServiceError) {
        self.why.get_or_init(|| why);
        self.over.cancel();
    }

    /// Cancelled when it is over.
    pub(crate) fn over(&self) -> &CancellationToken {
        &self.over
    }

    /// Why it is over.
    pub(crate) fn why(&self) -> ServiceError {
        self.why.get().cloned().unwrap_or_else(now_asked)
    }
}

/// Why a call ends that was let in without a token.
pub(super) fn now_asked() -> ServiceError {
    ServiceError::unauthenticated(
        "this call began without a token, and the server now asks for one; ask who runs the server for one",
    )
}

/// Why a call ends whose token was deleted while it went on.
pub(super) fn deleted(token: &str) -> ServiceError {
    ServiceError::unauthenticated(format_args!(
        "the token {token}, which this call began with, was deleted; ask who runs the server for a new one"
    ))
}
