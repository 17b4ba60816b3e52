//! Sessions are taken out of a map again: those that a merge brought, or one that somebody does not want.

use std::collections::BTreeSet;
use std::sync::Arc;

use tokio::runtime::Handle;
use topomap::event::SessionId;
use topomap::retelling::without_sessions;

use super::source::ReadMap;
use super::{MergeView, changed, undecidable};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::frames::no_such_session;
use crate::service::jobs::{JobOutcome, JobReporter, JobStatus, Stopped};
use crate::service::names::{map_name, session_in};
use crate::storage::{JobKind, MapRow, MergeOutcome, MergeState, RetoldLog, StorageError};

impl Service {
    /// Takes what a merge brought out of its target again.
    pub(crate) async fn undo_merge(self: &Arc<Self>, name: &str) -> Result<MergeView, ServiceError> {
        let view = self.merge(name).await?;
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
        self.check_nobody_is_led(&map)?;
        let outcome = MergeOutcome { number, state: MergeState::Undone, report: view.report.to_json()? };
        if let Some(made_events) = view.report.made_events {
            return self.undo_made(map, made_events, outcome).await;
        }
        let sessions = self.storage.sessions_of_merge(map.id, number).await?;
        let work = |service: Arc<Self>, reporter: JobReporter| async move {
            service.take_out(map, sessions, Some(outcome), &reporter).await
        };
        let job = self.start_job(JobKind::RemoveSessions, work).await?;
        self.storage.set_merge_job(number, job.number).await?;
        self.merge_of_number(number).await
    }

    /// Takes a session out of a map, by `maps/{map}/sessions/{session}`.
    pub(crate) async fn remove_session(self: &Arc<Self>, name: &str) -> Result<JobStatus, ServiceError> {
        let (map, session) = session_in(name)?;
        let row = self.map_row(map).await?;
        let number = self.storage.session_number(row.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(map, session))?;
        self.check_nobody_is_led(&row)?;
        let work = |service: Arc<Self>, reporter: JobReporter| async move {
            service.take_out(row, vec![number], None, &reporter).await
        };
        self.start_job(JobKind::RemoveSessions, work).await
    }

    /// A map that a merge has made goes as a whole, as long as nothing has come to it since.
    async fn undo_made(
        self: &Arc<Self>,
        map: MapRow,
        made_events: u64,
        outcome: MergeOutcome,
    ) -> Result<MergeView, ServiceError> {
        let number = outcome.number;
        let work = |service: Arc<Self>, reporter: JobReporter| async move {
            let end = reporter.succeeded(format!("merges/{number}"));
            let (storage, stored_end, map_name) = (service.storage.clone(), end.clone(), map.name.clone());
            let asking = service.clone();
            let undoing = move |runtime: &Handle| {
                asking.check_nobody_is_led(&map)?;
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
            match service.with_map_closed(&map_name, undoing).await {
                Ok(()) => {
                    service.removal_wanted();
                    JobOutcome::Stored { end, model: None }
                }
                Err(error) => JobOutcome::Failed(error),
            }
        };
        let job = self.start_job(JobKind::RemoveSessions, work).await?;
        self.storage.set_merge_job(number, job.number).await?;
        self.merge_of_number(number).await
    }

    async fn take_out(
        self: &Arc<Self>,
        map: MapRow,
        sessions: Vec<SessionId>,
        undone: Option<MergeOutcome>,
        reporter: &JobReporter,
    ) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        // The last moment to stop: the map's robots wait from now on.
        if Stopped::unless(reporter.progress("telling the map anew", 0.0)).is_err() {
            return JobOutcome::Cancelled;
        }
        let model = match self.loaded_model(&map.model).await {
            Ok(model) => model,
            Err(error) => return JobOutcome::Failed(error),
        };
        let end = reporter.succeeded(map_name(&map.name));
        let (storage, stored_end, name) = (self.storage.clone(), end.clone(), map.name.clone());
        let service = self.clone();
        let retelling = move |runtime: &Handle| {
            // Asked again: it may have waited for its turn.
            service.check_nobody_is_led(&map)?;
            let edition = map.edition();
            let read = ReadMap::read((runtime, &storage), map, &model, None)?;
            // Sessions may have other numbers by now than those that are to go.
            if read.row.edition() != edition {
                return Err(retold_meanwhile());
            }
            let removed: BTreeSet<SessionId> = sessions.iter().copied().collect();
            let retold = without_sessions(read.mapper.settings(), &read.log.events, &removed);
            let retold = retold.map_err(ServiceError::internal)?;
            let log = RetoldLog::new(read.row.edition(), &read.log.events, retold);
            let stored = runtime.block_on(storage.retell(&log, undone.as_ref(), Some(&stored_end)));
            stored.map_err(|error| match error {
                StorageError::Retold => retold_meanwhile(),
                error => changed(error),
            })
        };
        match self.with_map_closed(&name, retelling).await {
            Ok(()) => JobOutcome::Stored { end, model: None },
            Err(error) => JobOutcome::Failed(error),
        }
    }

    /// Places may have other numbers afterwards: a robot must not end up at another place than it was sent to.
    pub(super) fn check_nobody_is_led(&self, map: &MapRow) -> Result<(), ServiceError> {
        if !self.navigations.any_on(map.id) {
            return Ok(());
        }
        Err(ServiceError::precondition(format_args!(
            "robots are being led through the map {}, or were a minute ago; end that first: places may have other numbers \
             afterwards",
            map.name
        )))
    }
}

fn retold_meanwhile() -> ServiceError {
    ServiceError::Aborted { message: "sessions were removed from the map meanwhile; try again".to_owned() }
}
