//! Work that takes longer than a call. What became of a job is kept in the database; how far one that
//! runs has come is kept in memory.

mod order;
mod reporter;

use std::collections::HashMap;
use std::future::Future;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tracing::Instrument;

pub(in crate::service) use self::order::{AskedBy, Begun, Order, Task};
pub(in crate::service) use self::reporter::Stopped;
pub(crate) use self::reporter::{JobOutcome, JobReporter};
use super::deleted_maps::DeletedMaps;
use super::tokens::Caller;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::names::id_in;
use crate::pages::{Page, numbered_page, page_from, page_size, rows_of_page};
use crate::role::Reach;
pub(crate) use crate::storage::JobKind;
use crate::storage::{JobEnd, JobRow, NewJob, Storage, StorageError, StoredError, StoredJobState};

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
    running: Arc<Mutex<HashMap<u64, RunningJob>>>,
    /// One heavy job at a time: robots are being served meanwhile.
    turn: Arc<Semaphore>,
    tasks: TaskTracker,
}

#[derive(Clone, Debug)]
struct RunningJob {
    status: watch::Receiver<JobStatus>,
    cancel: CancellationToken,
}

/// How long jobs that have ended are kept.
const KEPT: Duration = Duration::from_secs(30 * 24 * 60 * 60);

/// How long a stop of the server waits for jobs to notice.
const STOPPING: Duration = Duration::from_secs(5);

/// A job that so many servers have begun is not begun again: it may be what ends them.
const MOST_BEGINNINGS: u32 = 5;

/// Why a job failed that still ran when the server stopped.
fn interrupted() -> ServiceError {
    ServiceError::aborted(
        "the server was stopped or restarted while this job ran; start it again: nothing will be there twice",
    )
}

/// Why a job failed that no server has come to the end of.
fn given_up() -> ServiceError {
    ServiceError::aborted(format_args!(
        "{MOST_BEGINNINGS} servers have begun this job, and none has come to its end before it was stopped or killed; see \
         in their logs why, then start it again: nothing will be there twice"
    ))
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
            Some(job) => job.status,
            None => {
                // In the database before it is gone from memory, so this finds whatever ended just now.
                let row = self.storage.job(number).await?.ok_or_else(|| no_such_job(name))?;
                watch::channel(status_of(row)).1
            }
        };
        let is_reached = status.borrow().is_reached_by(caller);
        if is_reached { Ok(status) } else { Err(caller.reaches_not(name)) }
    }

    /// Asks a job to stop; one that has ended stays as it is.
    pub(crate) async fn cancel(&self, caller: &Caller, name: &str) -> Result<JobStatus, ServiceError> {
        self.get(caller, name).await?;
        let number = job_number(name)?;
        if let Some(job) = self.running(number) {
            // Should the server end before the job has noticed, no other one is to go on with it.
            self.storage.forget_task(number).await?;
            job.cancel.cancel();
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

    /// Starts a job, and leaves it to itself. `work` reports to what it is given.
    pub(super) async fn start<Work>(
        &self,
        order: Order,
        work: impl FnOnce(JobReporter) -> Work + Send + 'static,
    ) -> Result<JobStatus, ServiceError>
    where
        Work: Future<Output = JobOutcome> + Send + 'static,
    {
        let jobs = self.clone();
        // Half of it would be a job that is there, and that nobody runs.
        to_its_end(async move { jobs.start_whole(order, work).await }).await
    }

    async fn start_whole<Work>(
        &self,
        order: Order,
        work: impl FnOnce(JobReporter) -> Work,
    ) -> Result<JobStatus, ServiceError>
    where
        Work: Future<Output = JobOutcome> + Send + 'static,
    {
        let Order { kind, maps, task, begun } = order;
        let stage = begun.stage();
        let task = task.as_ref().map(Task::to_json);
        let survives = task.is_some();
        let (number, created_ns) = match begun {
            Begun::Before(JobRow { number, created_ns, .. }) => (number, created_ns),
            Begun::Now => {
                let job = NewJob { kind, maps: maps.join(","), task, stage, created_ns: now_ns() };
                (self.storage.insert_job(&job).await?, job.created_ns)
            }
        };
        let status = JobStatus {
            number,
            kind,
            state: JobState::Running,
            stage: stage.to_owned(),
            fraction: 0.0,
            created_ns,
            ended_ns: None,
            maps: Some(maps),
        };
        let reporter = self.begin(&status);
        // Looked at after the job can be found: a stop that missed it is noticed here.
        if self.stopping.is_cancelled() {
            reporter.cancel.cancel();
        }
        let jobs = self.clone();
        let work = work(reporter.clone());
        self.tasks.spawn(async move {
            let outcome = match tokio::spawn(work).await {
                Ok(outcome) => outcome,
                Err(panic) => JobOutcome::Failed(ServiceError::internal(panic)),
            };
            let is_stored = matches!(outcome, JobOutcome::Stored(_));
            if survives && !is_stored && jobs.stopping.is_cancelled() {
                // Whatever ended it, the next server goes on with it.
                jobs.lock().remove(&reporter.number);
                return;
            }
            jobs.end(&reporter, outcome).await;
        });
        Ok(status)
    }

    /// A job of an earlier server with which this one cannot go on has failed.
    pub(super) async fn fail(&self, job: JobRow, error: ServiceError) -> Result<(), StorageError> {
        let JobRow { number, stage, .. } = job;
        tracing::warn!(job = number, %error, "a job of an earlier server cannot go on");
        let error = Some(error.into());
        let state = StoredJobState::Failed;
        self.storage.end_job(&JobEnd { number, state, stage, result: None, error, ended_ns: now_ns() }).await
    }

    async fn end(&self, reporter: &JobReporter, outcome: JobOutcome) {
        let ended = |state, error| JobEnd { error, ..reporter.end(state) };
        let (end, state, stored) = match outcome {
            JobOutcome::Stored(end) => {
                let result = end.result.clone().unwrap_or_default();
                (end, JobState::Succeeded(result), Ok(()))
            }
            // Nobody else cancels jobs when the server stops.
            JobOutcome::Cancelled if self.stopping.is_cancelled() => {
                let end = ended(StoredJobState::Failed, Some(interrupted().into()));
                let stored = self.storage.end_job(&end).await;
                (end, JobState::Failed(interrupted()), stored)
            }
            JobOutcome::Cancelled => {
                let end = ended(StoredJobState::Cancelled, None);
                let stored = self.storage.end_job(&end).await;
                (end, JobState::Cancelled, stored)
            }
            JobOutcome::Failed(error) => {
                let end = ended(StoredJobState::Failed, Some(StoredError::from(error.clone())));
                let stored = self.storage.end_job(&end).await;
                (end, JobState::Failed(error), stored)
            }
        };
        reporter.status.send_modify(|status| {
            status.fraction = if matches!(state, JobState::Succeeded(_)) { 1.0 } else { 0.0 };
            (status.state, status.stage, status.ended_ns) = (state, end.stage, Some(end.ended_ns));
        });
        // What an import that did not succeed left is taken away once its end is noted.
        self.deleted_maps.wanted();
        match stored {
            Ok(()) => {
                self.lock().remove(&reporter.number);
            }
            // It is told from memory for as long as the server runs.
            Err(error) => {
                tracing::warn!(job = reporter.number, %error, "the end of a job could not be stored");
            }
        }
    }

    /// At the start of a server: jobs of an earlier one that still ran, and with which this one cannot go on, were cut off.
    pub(crate) async fn settle(&self) -> Result<(), ServiceError> {
        let cut_off = self.storage.fail_jobs_cut_off(&interrupted().into(), now_ns()).await?;
        if cut_off > 0 {
            tracing::warn!(jobs = cut_off, "jobs were cut off when the server went down");
        }
        let given_up = self.storage.fail_jobs_begun(MOST_BEGINNINGS, &given_up().into(), now_ns()).await?;
        if given_up > 0 {
            tracing::error!(jobs = given_up, "jobs are given up: no server has come to their ends");
        }
        let kept_ns = i64::try_from(KEPT.as_nanos()).unwrap_or(i64::MAX);
        self.storage.delete_jobs_ended_before(now_ns().saturating_sub(kept_ns)).await?;
        Ok(())
    }

    /// Cancels every job, waits for them to notice, and notes those that did not.
    pub(super) async fn stop(&self) {
        self.lock().values().for_each(|job| job.cancel.cancel());
        self.tasks.close();
        if tokio::time::timeout(STOPPING, self.tasks.wait()).await.is_err() {
            tracing::warn!("some jobs did not end in time and were cut off");
            if let Err(error) = self.storage.fail_jobs_cut_off(&interrupted().into(), now_ns()).await {
                tracing::warn!(%error, "that they were cut off could not be stored");
            }
        }
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
    fn begin(&self, status: &JobStatus) -> JobReporter {
        let (sender, receiver) = watch::channel(status.clone());
        let cancel = CancellationToken::new();
        self.lock().insert(status.number, RunningJob { status: receiver, cancel: cancel.clone() });
        JobReporter { number: status.number, status: sender, cancel, turn: self.turn.clone() }
    }

    /// Lets a task run that a stop of the server waits for.
    pub(super) fn track(&self, task: impl Future<Output = ()> + Send + 'static) {
        self.tasks.spawn(task);
    }

    /// How many have not ended.
    pub(crate) fn count(&self) -> usize {
        self.lock().len()
    }

    fn running(&self, number: u64) -> Option<RunningJob> {
        self.lock().get(&number).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<u64, RunningJob>> {
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
