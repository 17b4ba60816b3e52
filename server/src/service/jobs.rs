//! Work that takes longer than a call.

use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;

use super::names::id_in;
use super::{Service, now_ns};
use crate::error::ServiceError;
use crate::storage::ModelRow;

/// A job as it stands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JobStatus {
    pub(crate) number: u64,
    pub(crate) state: JobState,
    /// What it is, or was last, busy with.
    pub(crate) stage: &'static str,
    /// How much of the stage is done, in [0, 1].
    pub(crate) fraction: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum JobState {
    Running,
    Succeeded(Box<ModelRow>),
    Failed(ServiceError),
    Cancelled,
}

/// All jobs since the server started; they do not outlive it.
#[derive(Debug)]
pub(crate) struct Jobs {
    jobs: Mutex<HashMap<u64, Job>>,
    /// Number of the first job: by the clock, so that no number is given again after a restart.
    first: u64,
    /// One heavy job at a time: robots are being served meanwhile.
    turn: Arc<Semaphore>,
}

#[derive(Clone, Debug)]
struct Job {
    status: watch::Receiver<JobStatus>,
    cancel: CancellationToken,
}

/// What a running job tells the world by.
#[derive(Clone, Debug)]
pub(crate) struct JobReporter {
    status: watch::Sender<JobStatus>,
    cancel: CancellationToken,
    turn: Arc<Semaphore>,
}

impl Default for Jobs {
    fn default() -> Self {
        let first = u64::try_from(now_ns() / 1_000_000).unwrap_or_default();
        Self { jobs: Mutex::default(), first, turn: Arc::new(Semaphore::new(1)) }
    }
}

impl Service {
    pub(crate) fn job(&self, name: &str) -> Result<JobStatus, ServiceError> {
        Ok(self.jobs.find(name)?.status.borrow().clone())
    }

    /// The job now and whenever it has moved on; the last one is the end.
    pub(crate) fn watch_job(&self, name: &str) -> Result<watch::Receiver<JobStatus>, ServiceError> {
        Ok(self.jobs.find(name)?.status)
    }

    /// Asks a job to stop; one that has ended stays as it is.
    pub(crate) fn cancel_job(&self, name: &str) -> Result<JobStatus, ServiceError> {
        let job = self.jobs.find(name)?;
        job.cancel.cancel();
        Ok(job.status.borrow().clone())
    }
}

impl Jobs {
    pub(crate) fn start(&self, stage: &'static str) -> (JobStatus, JobReporter) {
        let mut jobs = self.lock();
        let number = self.first + jobs.len() as u64;
        let status = JobStatus { number, state: JobState::Running, stage, fraction: 0.0 };
        let (sender, receiver) = watch::channel(status.clone());
        let cancel = CancellationToken::new();
        jobs.insert(number, Job { status: receiver, cancel: cancel.clone() });
        (status, JobReporter { status: sender, cancel, turn: self.turn.clone() })
    }

    pub(crate) fn cancel_all(&self) {
        self.lock().values().for_each(|job| job.cancel.cancel());
    }

    fn find(&self, name: &str) -> Result<Job, ServiceError> {
        let number = id_in("jobs", name)?.parse::<u64>().ok();
        let job = number.and_then(|number| self.lock().get(&number).cloned());
        job.ok_or_else(|| {
            ServiceError::not_found(format_args!(
                "there is no job {name}; jobs do not outlive the server, so if it was restarted, start the job again"
            ))
        })
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<u64, Job>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl JobReporter {
    /// Waits until no other heavy job runs, or this one is cancelled.
    pub(crate) async fn wait_for_turn(&self) -> Option<tokio::sync::OwnedSemaphorePermit> {
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
                (status.stage, status.fraction) = (stage, fraction);
            }
            moved
        });
        if self.cancel.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// The last word.
    pub(crate) fn end(self, state: JobState) {
        self.status.send_modify(|status| {
            if matches!(state, JobState::Succeeded(_)) {
                status.fraction = 1.0;
            }
            status.state = state;
        });
    }
}
