//! Jobs that an earlier server began, and this one goes on with.

use std::sync::Arc;
use std::time::Duration;

use super::Service;
use super::jobs::{Begun, JobOutcome, JobReporter, Task};
use super::tokens::{Access, Caller};
use crate::error::ServiceError;

/// How often it is tried where the database is held up.
const AGAIN: Duration = Duration::from_secs(5);

impl Service {
    /// Goes on in the background with what earlier servers did not come to the end of, the oldest first.
    pub(crate) async fn take_up_jobs(self: &Arc<Self>) -> Result<(), ServiceError> {
        let left_over = self.jobs.left_over().await?;
        let service = self.clone();
        self.jobs.track(async move {
            for (job, task) in left_over {
                service.take_up(job, task).await;
            }
        });
        Ok(())
    }

    async fn take_up(&self, job: JobReporter, task: Option<Task>) {
        let number = job.number();
        let taken_up = loop {
            match self.begin_again(&job, task.clone()).await {
                Err(ServiceError::Unavailable { .. }) => {
                    tokio::select! {
                        () = tokio::time::sleep(AGAIN) => {}
                        // The next one goes on with it.
                        () = self.stopping.cancelled() => return,
                    }
                }
                taken_up => break taken_up,
            }
        };
        match taken_up {
            Ok(()) => tracing::info!(job = number, "a job of an earlier server goes on"),
            Err(error) => {
                tracing::warn!(job = number, %error, "a job of an earlier server cannot go on");
                self.merges.fail_with_job(number, &error).await;
                self.jobs.end(&job, JobOutcome::Failed(error)).await;
            }
        }
    }

    async fn begin_again(&self, job: &JobReporter, task: Option<Task>) -> Result<(), ServiceError> {
        let task = task.ok_or_else(|| {
            ServiceError::aborted(
                "the server that began this job ended, and this one does not know what it was asked for; start it again",
            )
        })?;
        let caller = self.caller(task.asked_by())?;
        let begun = Begun::Before(Box::new(job.clone()));
        match task {
            Task::CompactMap { map, asked_by: _ } => {
                self.rewriting.start_compacting(&caller, &map, begun).await.map(drop)
            }
            Task::RebuildMap { map, model, into, asked_by: _ } => {
                self.rebuilding.start_rebuilding(&caller, &map, &model, &into, begun).await.map(drop)
            }
            Task::RepairMap { map, into, copy, asked_by: _ } => {
                self.rebuilding.start_repairing(&caller, &map, &into, &copy, begun).await.map(drop)
            }
            Task::SearchMerge { merge, request, asked_by: _ } => {
                self.merges.search_again(merge, request, &caller, begun).await
            }
        }
    }

    /// Who asked for a job, as they are known now.
    fn caller(&self, token: Option<&str>) -> Result<Caller, ServiceError> {
        let Some(name) = token else { return Ok(Caller::anybody()) };
        let caller = self.tokens.caller_named(name);
        let caller = caller.filter(|caller| caller.check(Access::ADMIN).is_ok());
        // Others than who asked read what became of the job.
        caller.ok_or_else(|| {
            tracing::warn!(token = name, "a job is not gone on with, since the token by which it was asked for is gone");
            ServiceError::precondition(
                "the token by which this job was asked for is gone, or good for less by now; start it again with another",
            )
        })
    }
}
