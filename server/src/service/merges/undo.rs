//! What a merge has brought is taken out of its target again.

use tokio::runtime::Handle;

use super::{MergeView, Merges, undecidable};
use crate::error::ServiceError;
use crate::service::jobs::{JobOutcome, JobReporter, JobRequest, to_its_end};
use crate::service::rewriting::changed;
use crate::service::tokens::Caller;
use crate::storage::{JobKind, MapRow, MergeOutcome, MergeState};

impl Merges {
    /// Takes what a merge brought out of its target again.
    pub(crate) async fn undo(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let (merges, caller, name) = (self.clone(), caller.clone(), name.to_owned());
        to_its_end(async move { merges.undo_whole(&caller, &name).await }).await
    }

    async fn undo_whole(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let view = self.get(caller, name).await?;
        let number = view.number;
        if view.state != MergeState::Committed {
            return Err(undecidable(&view, "undone"));
        }
        let row = self.storage.merge(number).await?.and_then(|row| row.map);
        let map = match row {
            Some(map) => self.storage.map_of_id(map).await?,
            None => None,
        };
        let map = map.ok_or_else(|| {
            ServiceError::precondition(format_args!(
                "the map {} was deleted or compacted since; what a merge has brought to a compacted map is taken out by its \
                 sessions",
                view.target
            ))
        })?;
        self.rewriting.check_nobody_is_led(&map)?;
        let outcome = MergeOutcome { number, state: MergeState::Undone, report: view.report.to_json()? };
        if let Some(made_events) = view.report.made_events {
            return self.undo_made(view, map, made_events, outcome).await;
        }
        let sessions = self.storage.sessions_of_merge(map.id, number).await?;
        let rewriting = self.rewriting.clone();
        let work = move |reporter: JobReporter| async move {
            rewriting.take_out(map, sessions, Some(outcome), &reporter).await
        };
        let job =
            self.jobs.start(JobRequest::of_this_server(JobKind::RemoveSessions, &view.maps()), work).await?;
        self.storage.set_merge_job(number, job.number).await?;
        self.merge_of_number(number).await
    }

    /// A map that a merge has made goes as a whole, as long as nothing has come to it since.
    async fn undo_made(
        &self,
        view: MergeView,
        map: MapRow,
        made_events: u64,
        outcome: MergeOutcome,
    ) -> Result<MergeView, ServiceError> {
        let number = outcome.number;
        let merges = self.clone();
        let work = move |reporter: JobReporter| async move {
            let end = reporter.succeeded(format!("merges/{number}"));
            let storage = merges.storage.clone();
            let stored_end = end.clone();
            let map_name = map.name.clone();
            let rewriting = merges.rewriting.clone();
            let undoing = move |runtime: &Handle| {
                rewriting.check_nobody_is_led(&map)?;
                let events = runtime.block_on(storage.log_events(map.id))?;
                if events != made_events {
                    return Err(ServiceError::precondition(format_args!(
                        "sessions have driven in the map {} since it was made; remove those that you do not want, or \
                         delete the map: what it was made of is still there",
                        map.name
                    )));
                }
                runtime.block_on(storage.undo_merged_map(map.id, &outcome, &stored_end)).map_err(changed)
            };
            match merges.open_maps.with_closed(&map_name, undoing).await {
                Ok(()) => {
                    merges.deleted_maps.wanted();
                    JobOutcome::Stored(end)
                }
                Err(error) => JobOutcome::Failed(error),
            }
        };
        let job =
            self.jobs.start(JobRequest::of_this_server(JobKind::RemoveSessions, &view.maps()), work).await?;
        self.storage.set_merge_job(number, job.number).await?;
        self.merge_of_number(number).await
    }
}
