//! Work that takes longer than a call. What became of a job is kept in the database; how far one that
//! runs has come is kept in memory.

mod reporter;
mod request;
mod running;

use std::collections::HashMap;
use std::future::Future;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tracing::Instrument;

pub(in crate::service) use self::reporter::Stopped;
pub(crate) use self::reporter::{JobOutcome, JobReporter};
pub(in crate::service) use self::request::{Begun, JobRequest, Task};
use super::deleted_maps::DeletedMaps;
use super::tokens::{Access, Caller};
use crate::error::ServiceError;
use crate::names::id_in;
use crate::pages::{Page, numbered_page, page_from, page_size, rows_of_page};
use crate::role::Reach;
pub(crate) use crate::storage::JobKind;
use crate::storage::{JobRow, Storage, StoredJobState};

/// A job as it stands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JobStatus {
    pub(crate) number: u64,
    pub(crate) kind: JobKind,
    pub(crate) state: JobState,
    /// What it is, or was last, busy with.
    pub(crate) stage: String,
    /// How much of the stage is done, in [0, 1].
    pub(crate) fraction: f64,
    pub(crate) created_ns: i64,
    pub(crate) ended_ns: Option<i64>,
    /// The names of the maps that it reads or writes; `None` if that is not known, as of jobs of earlier servers.
    pub(crate) maps: Option<Vec<String>>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum JobState {
    Running,
    /// What it made: `models/{hash}`, `maps/{map}` or `merges/{number}`.
    Succeeded(String),
    Failed(ServiceError),
    Cancelled,
}

/// Jobs: those that run are here, those that have ended in the database. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Jobs {
    storage: Storage,
    deleted_maps: DeletedMaps,
    stopping: CancellationToken,
    running: Arc<Mutex<HashMap<u64, JobReporter>>>,
    /// One heavy job at a time: robots are being served meanwhile.
    turn: Arc<Semaphore>,
    tasks: TaskTracker,
}

impl Jobs {
    pub(super) fn new(storage: Storage, deleted_maps: DeletedMaps, stopping: CancellationToken) -> Self {
        Self {
            storage,
            deleted_maps,
            stopping,
            running: Arc::default(),
            turn: Arc::new(Semaphore::new(1)),
            tasks: TaskTracker::new(),
        }
    }

    pub(crate) async fn get(&self, caller: &Caller, name: &str) -> Result<JobStatus, ServiceError> {
        Ok(self.watch(caller, name).await?.borrow().clone())
    }

    /// The job now and whenever it has moved on; the last one is the end.
    pub(crate) async fn watch(
        &self,
        caller: &Caller,
        name: &str,
    ) -> Result<watch::Receiver<JobStatus>, ServiceError> {
        let number = job_number(name)?;
        let status = match self.running(number) {
            Some(job) => job.status.subscribe(),
            None => {
                // In the database before it is gone from memory, so this finds whatever ended just now.
                let row = self.storage.job(number).await?.ok_or_else(|| no_such_job(name))?;
                watch::channel(status_of(row)).1
            }
        };
        let is_reached = status.borrow().is_reached_by(caller);
        if is_reached { Ok(status) } else { Err(caller.reaches_not(name)) }
    }

    /// Whether the server ends.
    pub(super) fn is_stopping(&self) -> bool {
        self.stopping.is_cancelled()
    }

    /// Asks a job to stop; one that has ended stays as it is.
    pub(crate) async fn cancel(&self, caller: &Caller, name: &str) -> Result<JobStatus, ServiceError> {
        let asked = self.get(caller, name).await?;
        // One of no map is about the whole server, as is the call that began it: a training.
        if asked.maps.is_some_and(|maps| maps.is_empty()) {
            caller.check(Access::Server)?;
        }
        let number = job_number(name)?;
        if let Some(job) = self.running(number) {
            job.no_longer_wanted();
            // Should the server be killed before the job has noticed, no other one is to go on with it.
            if let Err(error) = self.storage.forget_task(number).await {
                tracing::warn!(job = number, %error, "a server that comes next may go on with a job that was cancelled");
            }
        }
        self.get(caller, name).await
    }

    /// All jobs about maps that the caller reaches, newest first.
    pub(crate) async fn list(
        &self,
        caller: &Caller,
        size: u32,
        token: &str,
    ) -> Result<Page<JobStatus>, ServiceError> {
        let size = page_size(size)?;
        let before = numbered_page(token)?;
        let read = |before| self.storage.jobs(before, size + 1);
        let number = |row: &JobRow| Some(row.number);
        let reached = |row: &JobRow| status_of(row.clone()).is_reached_by(caller);
        let mut rows = rows_of_page(size, before, read, number, reached).await?;
        let more = rows.len() > size as usize;
        rows.truncate(size as usize);
        let next = rows.last().filter(|_| more).map_or_else(String::new, |row| page_from(row.number));
        let mut items = Vec::with_capacity(rows.len());
        for row in rows {
            items.push(match self.running(row.number) {
                Some(job) => job.status.borrow().clone(),
                None => status_of(row),
            });
        }
        Ok(Page { items, next })
    }
}

/// Does what has several steps to its end, also where whoever asked for it has gone: half of it would be in the way.
pub(super) async fn to_its_end<T: Send + 'static>(
    work: impl Future<Output = Result<T, ServiceError>> + Send + 'static,
) -> Result<T, ServiceError> {
    tokio::spawn(work.in_current_span()).await.map_err(ServiceError::internal)?
}

fn status_of(row: JobRow) -> JobStatus {
    let JobRow { number, kind, state, stage, result, error, created_ns, ended_ns, maps, task: _ } = row;
    let (state, fraction) = match state {
        // Not in memory yet: it has only just begun.
        StoredJobState::Running => (JobState::Running, 0.0),
        StoredJobState::Cancelled => (JobState::Cancelled, 0.0),
        StoredJobState::Failed => {
            (JobState::Failed(error.map_or(ServiceError::Internal, ServiceError::from)), 0.0)
        }
        StoredJobState::Succeeded => (JobState::Succeeded(result.unwrap_or_default()), 1.0),
    };
    let maps = maps.map(|maps| maps.split(',').filter(|map| !map.is_empty()).map(str::to_owned).collect());
    JobStatus { number, kind, state, stage, fraction, created_ns, ended_ns, maps }
}

impl JobStatus {
    fn is_reached_by(&self, caller: &Caller) -> bool {
        match &self.maps {
            Some(maps) => caller.reaches(maps.iter().map(String::as_str)),
            None => caller.reach == Reach::Everywhere,
        }
    }
}

impl Jobs {
    /// Lets a task run that a stop of the server waits for.
    pub(super) fn track(&self, task: impl Future<Output = ()> + Send + 'static) {
        self.tasks.spawn(task);
    }

    /// How many have not ended.
    pub(crate) fn count(&self) -> usize {
        self.lock().len()
    }

    fn running(&self, number: u64) -> Option<JobReporter> {
        self.lock().get(&number).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<u64, JobReporter>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn job_number(name: &str) -> Result<u64, ServiceError> {
    id_in("jobs", name)?.parse().map_err(|_| no_such_job(name))
}

fn no_such_job(name: &str) -> ServiceError {
    ServiceError::not_found(format_args!(
        "there is no job {name}; list the jobs to see what there is: those that ended more than 30 days ago are forgotten"
    ))
}
