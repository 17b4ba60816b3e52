//! Jobs that an earlier server began, and this one goes on with.

use super::Service;
use super::jobs::{AskedBy, Begun, JobStatus, Task};
use super::merges::MergeView;
use super::tokens::Caller;
use crate::error::ServiceError;
use crate::storage::JobRow;

impl Service {
    /// Goes on with what earlier servers did not come to the end of, in the order in which it was asked for.
    pub(crate) async fn take_up_jobs(&self) -> Result<(), ServiceError> {
        for job in self.storage.begin_jobs_again().await? {
            let number = job.number;
            match self.take_up(job.clone()).await {
                Ok(()) => tracing::info!(job = number, "a job of an earlier server goes on"),
                Err(error) => self.jobs.fail(job, error).await?,
            }
        }
        Ok(())
    }

    async fn take_up(&self, job: JobRow) -> Result<(), ServiceError> {
        let Some(task) = job.task.as_deref().and_then(Task::from_json) else {
            return Err(ServiceError::aborted(
                "the server that began this job ended, and this one does not know what it was asked for; start it again",
            ));
        };
        let begun = Begun::Before(job.clone());
        let job_goes_on = |_: JobStatus| ();
        let merge_goes_on = |_: MergeView| ();
        match task {
            Task::CompactMap { map } => self.rewriting.start_compacting(&map, begun).await.map(job_goes_on),
            Task::DeleteSession { session } => {
                self.rewriting.start_deleting_session(&session, begun).await.map(job_goes_on)
            }
            Task::RebuildMap { map, model, into, asked_by } => {
                let caller = self.caller(asked_by)?;
                self.rebuilding.start_rebuilding(&caller, &map, &model, &into, begun).await.map(job_goes_on)
            }
            Task::RepairMap { map, into, copy, asked_by } => {
                let caller = self.caller(asked_by)?;
                self.rebuilding.start_repairing(&caller, &map, &into, &copy, begun).await.map(job_goes_on)
            }
            Task::SearchMerge { merge, request, asked_by } => {
                let caller = self.caller(asked_by)?;
                self.merges.search_again(merge, request, &caller, job).await.map(merge_goes_on)
            }
            Task::UndoMerge { merge } => self.merges.undo_again(merge, job).await.map(merge_goes_on),
        }
    }

    /// Who asked for a job, as they are known now.
    fn caller(&self, AskedBy(token): AskedBy) -> Result<Caller, ServiceError> {
        let Some(name) = token else { return Ok(Caller::anybody()) };
        self.tokens.caller_named(&name).ok_or_else(|| {
            ServiceError::precondition(format_args!(
                "the token {name}, by which this job was asked for, is gone; start it again with another"
            ))
        })
    }
}
