//! What the work of a job is told, and tells.

use std::ops::ControlFlow;
use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio_util::sync::CancellationToken;

use super::JobStatus;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::storage::{JobEnd, StoredJobState};

/// What a running job tells the world by.
#[derive(Clone, Debug)]
pub(crate) struct JobReporter {
    pub(super) number: u64,
    pub(super) status: watch::Sender<JobStatus>,
    pub(super) cancel: CancellationToken,
    pub(super) turn: Arc<Semaphore>,
}

impl JobReporter {
    pub(crate) fn number(&self) -> u64 {
        self.number
    }

    /// Waits until no other heavy job runs, or this one is cancelled.
    pub(crate) async fn wait_for_turn(&self) -> Option<OwnedSemaphorePermit> {
        tokio::select! {
            permit = self.turn.clone().acquire_owned() => permit.ok(),
            () = self.cancel.cancelled() => None,
        }
    }

    /// Reports progress and hears whether to go on.
    pub(crate) fn progress(&self, stage: &'static str, fraction: f64) -> ControlFlow<()> {
        self.status.send_if_modified(|status| {
            // A percent at a time is enough for a progress bar.
            let moved = status.stage != stage || (fraction - status.fraction).abs() >= 0.01;
            if moved {
                (status.stage, status.fraction) = (stage.to_owned(), fraction);
            }
            moved
        });
        if self.cancel.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Says in words that are its own how it ended.
    pub(in crate::service) fn told(&self, stage: String) {
        self.status.send_modify(|status| (status.stage, status.fraction) = (stage, 1.0));
    }

    /// The job's end, for the transaction that stores what it made.
    pub(in crate::service) fn succeeded(&self, result: String) -> JobEnd {
        JobEnd { result: Some(result), ..self.end(StoredJobState::Succeeded) }
    }

    pub(super) fn end(&self, state: StoredJobState) -> JobEnd {
        let stage = self.status.borrow().stage.clone();
        JobEnd { number: self.number, state, stage, result: None, error: None, ended_ns: now_ns() }
    }
}

/// How a job came to its end.
pub(crate) enum JobOutcome {
    /// It succeeded, and the database knows it: in the same transaction as what the job made.
    Stored(JobEnd),
    Failed(ServiceError),
    Cancelled,
}

/// Why the work of a job did not come to its end.
pub(in crate::service) enum Stopped {
    Cancelled,
    Failed(ServiceError),
}

impl Stopped {
    pub(in crate::service) fn unless(goes_on: ControlFlow<()>) -> Result<(), Self> {
        if goes_on.is_continue() { Ok(()) } else { Err(Self::Cancelled) }
    }
}

impl From<ServiceError> for Stopped {
    fn from(error: ServiceError) -> Self {
        Self::Failed(error)
    }
}

impl From<Stopped> for JobOutcome {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Cancelled => Self::Cancelled,
            Stopped::Failed(error) => Self::Failed(error),
        }
    }
}
