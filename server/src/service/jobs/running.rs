//! Jobs begin, end, and go on with another server.

use std::future::Future;
use std::time::Duration;

use super::request::{Begun, JobRequest, Task};
use super::{JobOutcome, JobReporter, JobState, JobStatus, Jobs, status_of, to_its_end};
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::storage::{JobEnd, NewJob, StorageError, StoredError, StoredJobState};

/// How long jobs that have ended are kept.
const KEPT: Duration = Duration::from_secs(30 * 24 * 60 * 60);

/// How long a stop of the server waits for jobs to notice.
const STOPPING: Duration = Duration::from_secs(5);

/// How often it is tried to store what became of a job.
const STORE_AGAIN: Duration = Duration::from_secs(5);

/// A job on which so many servers ended in no good order is not begun again: it may be what ends them.
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
        "{MOST_BEGINNINGS} servers were killed, or crashed, while they worked on this job; see in their logs why, then start \
         it again: nothing will be there twice"
    ))
}

impl Jobs {
    /// Starts a job, and leaves it to itself. `work` reports to what it is given.
    pub(in crate::service) async fn start<Work>(
        &self,
        request: JobRequest,
        work: impl FnOnce(JobReporter) -> Work + Send + 'static,
    ) -> Result<JobStatus, ServiceError>
    where
        Work: Future<Output = JobOutcome> + Send + 'static,
    {
        let jobs = self.clone();
        // Half of it would be a job that is there, and that nobody runs.
        to_its_end(async move { jobs.start_whole(request, work).await }).await
    }

    async fn start_whole<Work>(
        &self,
        request: JobRequest,
        work: impl FnOnce(JobReporter) -> Work,
    ) -> Result<JobStatus, ServiceError>
    where
        Work: Future<Output = JobOutcome> + Send + 'static,
    {
        let reporter = match request.begun.clone() {
            Begun::Before(reporter) => *reporter,
            Begun::Now => self.insert(request).await?,
        };
        let status = reporter.status.borrow().clone();
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
            jobs.end(&reporter, outcome).await;
        });
        Ok(status)
    }

    async fn insert(&self, request: JobRequest) -> Result<JobReporter, ServiceError> {
        let JobRequest { kind, maps, task, begun: _ } = request;
        let task = task.as_ref().map(Task::to_json);
        let survives = task.is_some();
        let stage = "waiting to start";
        let job = NewJob { kind, maps: maps.join(","), task, stage, created_ns: now_ns() };
        let number = self.storage.insert_job(&job).await?;
        Ok(self.put(JobReporter::new(
            JobStatus {
                number,
                kind,
                state: JobState::Running,
                stage: stage.to_owned(),
                fraction: 0.0,
                created_ns: job.created_ns,
                ended_ns: None,
                maps: Some(maps),
            },
            self,
            survives,
        )))
    }

    /// The jobs that earlier servers did not come to the end of, oldest first, and what they are to do; `None` if that is
    /// of a later server. From now on they can be watched and cancelled here.
    pub(in crate::service) async fn left_over(
        &self,
    ) -> Result<Vec<(JobReporter, Option<Task>)>, StorageError> {
        let mut left_over = Vec::new();
        for number in self.storage.running_jobs().await? {
            let Some(row) = self.storage.job(number).await? else { continue };
            let task = row.task.as_deref().and_then(Task::from_json);
            let stage = "waiting to go on: its server ended".to_owned();
            let status = JobStatus { stage, ..status_of(row) };
            left_over.push((self.put(JobReporter::new(status, self, true)), task));
        }
        Ok(left_over)
    }

    fn put(&self, reporter: JobReporter) -> JobReporter {
        self.lock().insert(reporter.number, reporter.clone());
        reporter
    }

    /// The job has ended, and says how; unless the next server goes on with it.
    pub(in crate::service) async fn end(&self, reporter: &JobReporter, outcome: JobOutcome) {
        let stopping = self.stopping.is_cancelled();
        let goes_on = reporter.survives && !reporter.is_unwanted();
        let is_stored = matches!(outcome, JobOutcome::Stored(_));
        if goes_on && stopping && !is_stored {
            // Whatever ended it. A server that stops in good order is not ended by its job.
            if reporter.had_its_turn()
                && let Err(error) = self.storage.take_back_beginning(reporter.number).await
            {
                tracing::warn!(job = reporter.number, %error, "a job counts a server that stops as one that was killed");
            }
            self.lock().remove(&reporter.number);
            return;
        }
        let ended = |state, error| JobEnd { error, ..reporter.end(state) };
        let (end, state) = match outcome {
            JobOutcome::Stored(end) => {
                let result = end.result.clone().unwrap_or_default();
                (end, JobState::Succeeded(result))
            }
            // Nobody else cancels jobs when the server stops.
            JobOutcome::Cancelled if stopping && !reporter.is_unwanted() => {
                (ended(StoredJobState::Failed, Some(interrupted().into())), JobState::Failed(interrupted()))
            }
            JobOutcome::Cancelled => (ended(StoredJobState::Cancelled, None), JobState::Cancelled),
            JobOutcome::Failed(error) => {
                let stored = Some(StoredError::from(error.clone()));
                (ended(StoredJobState::Failed, stored), JobState::Failed(error))
            }
        };
        let stored = if is_stored { Ok(()) } else { self.storage.end_job(&end).await };
        match stored {
            Ok(()) => {
                self.tell(reporter, end, state);
                self.lock().remove(&reporter.number);
            }
            // The owner of the database goes on with it.
            Err(StorageError::TakenOver) if goes_on => {
                self.lock().remove(&reporter.number);
            }
            // It is told from memory for as long as the server runs.
            Err(error) => {
                tracing::warn!(job = reporter.number, %error, "the end of a job could not be stored");
                self.tell(reporter, end.clone(), state);
                self.store_later(end);
            }
        }
        // What an import that did not succeed left is taken away once its end is noted.
        self.deleted_maps.wanted();
    }

    fn tell(&self, reporter: &JobReporter, end: JobEnd, state: JobState) {
        reporter.status.send_modify(|status| {
            status.fraction = if matches!(state, JobState::Succeeded(_)) { 1.0 } else { 0.0 };
            (status.state, status.stage, status.ended_ns) = (state, end.stage, Some(end.ended_ns));
        });
    }

    /// Stores what became of a job as soon as that can be: the next server would do it once more.
    fn store_later(&self, end: JobEnd) {
        let jobs = self.clone();
        self.tasks.spawn(async move {
            let mut last = false;
            while !last {
                tokio::select! {
                    () = tokio::time::sleep(STORE_AGAIN) => {}
                    () = jobs.stopping.cancelled() => last = true,
                }
                if let Ok(()) | Err(StorageError::JobEnded) = jobs.storage.end_job(&end).await {
                    jobs.lock().remove(&end.number);
                    return;
                }
            }
        });
    }

    /// At the start of a server: jobs of an earlier one that still ran, and with which this one cannot go on, were cut off.
    pub(crate) async fn settle(&self) -> Result<(), ServiceError> {
        let cut_off = self.storage.fail_jobs_without_task(&interrupted().into(), now_ns()).await?;
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
    pub(in crate::service) async fn stop(&self) {
        self.lock().values().for_each(|job| job.cancel.cancel());
        self.tasks.close();
        if tokio::time::timeout(STOPPING, self.tasks.wait()).await.is_err() {
            tracing::warn!("some jobs did not end in time and were cut off");
            if let Err(error) = self.storage.fail_jobs_without_task(&interrupted().into(), now_ns()).await {
                tracing::warn!(%error, "that they were cut off could not be stored");
            }
        }
    }
}
