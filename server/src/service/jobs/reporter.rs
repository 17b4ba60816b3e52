//! What the work of a job is told, and tells.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio_util::sync::CancellationToken;

use super::{JobStatus, Jobs};
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::storage::{JobEnd, Storage, StoredJobState};

/// What a running job tells the world by.
#[derive(Clone, Debug)]
pub(crate) struct JobReporter {
    pub(super) number: u64,
    pub(super) status: watch::Sender<JobStatus>,
    pub(super) cancel: CancellationToken,
    /// Whether another server goes on with it if this one ends first.
    pub(super) survives: bool,
    /// Whether somebody cancelled it, and not the end of the server.
    unwanted: Arc<AtomicBool>,
    had_its_turn: Arc<AtomicBool>,
    turn: Arc<Semaphore>,
    storage: Storage,
}

impl JobReporter {
    pub(super) fn new(status: JobStatus, jobs: &Jobs, survives: bool) -> Self {
        Self {
            number: status.number,
            status: watch::Sender::new(status),
            cancel: CancellationToken::new(),
            survives,
            unwanted: Arc::default(),
            had_its_turn: Arc::default(),
            turn: jobs.turn.clone(),
            storage: jobs.storage.clone(),
        }
    }

    pub(crate) fn number(&self) -> u64 {
        self.number
    }

    /// Waits until no other heavy job runs, or this one is cancelled.
    pub(crate) async fn wait_for_turn(&self) -> Option<OwnedSemaphorePermit> {
        let permit = tokio::select! {
            permit = self.turn.clone().acquire_owned() => permit.ok(),
            () = self.cancel.cancelled() => None,
        }?;
        if self.survives {
            self.had_its_turn.store(true, Ordering::Relaxed);
            if let Err(error) = self.storage.count_beginning(self.number).await {
                tracing::warn!(job = self.number, %error, "it is not noted that this server began a job");
            }
        }
        Some(permit)
    }

    /// Somebody no longer wants it.
    pub(super) fn no_longer_wanted(&self) {
        self.unwanted.store(true, Ordering::Relaxed);
        self.cancel.cancel();
    }

    pub(super) fn is_unwanted(&self) -> bool {
        self.unwanted.load(Ordering::Relaxed)
    }

    pub(super) fn had_its_turn(&self) -> bool {
        self.had_its_turn.load(Ordering::Relaxed)
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
