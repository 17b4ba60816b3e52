//! Sessions are taken out of a map.

use std::collections::BTreeSet;

use tokio::runtime::Handle;
use topomap::ids::SessionId;
use topomap::rewriting::without_sessions;

use super::{Rewriting, changed};
use crate::error::ServiceError;
use crate::names::{map_name, session_in};
use crate::service::frames::no_such_session;
use crate::service::jobs::{JobOutcome, JobReporter, JobRequest, JobStatus, Stopped};
use crate::service::read_map::{Disk, ReadMap};
use crate::storage::{JobKind, MapRow, MergeOutcome, RetoldLog, StorageError};

impl Rewriting {
    /// Takes a session out of a map, by `maps/{map}/sessions/{session}`.
    pub(crate) async fn delete_session(&self, name: &str) -> Result<JobStatus, ServiceError> {
        let (map, session) = session_in(name)?;
        let row = self.open_maps.row(map).await?;
        let number = self.storage.session_number(row.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(map, session))?;
        self.check_nobody_is_led(&row)?;
        let request = JobRequest::of_this_server(JobKind::RemoveSessions, &[map]);
        let rewriting = self.clone();
        let work = move |reporter: JobReporter| async move {
            rewriting.take_out(row, vec![number], None, &reporter).await
        };
        self.jobs.start(request, work).await
    }

    /// Takes sessions out of a map, as a job that is undoing a merge if `undone` says so.
    pub(in crate::service) async fn take_out(
        &self,
        map: MapRow,
        sessions: Vec<SessionId>,
        undone: Option<MergeOutcome>,
        reporter: &JobReporter,
    ) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        // The last moment to stop: the map's robots wait from now on.
        if Stopped::unless(reporter.progress("rewriting the map", 0.0)).is_err() {
            return JobOutcome::Cancelled;
        }
        let model = match self.models.get(&map.model).await {
            Ok(model) => model,
            Err(error) => return JobOutcome::Failed(error),
        };
        let end = reporter.succeeded(map_name(&map.name));
        let storage = self.storage.clone();
        let stored_end = end.clone();
        let name = map.name.clone();
        let rewriting = self.clone();
        let retelling = move |runtime: &Handle| {
            // Asked again: it may have waited for its turn.
            rewriting.check_nobody_is_led(&map)?;
            let edition = map.edition();
            let read = ReadMap::read(Disk { runtime, storage: &storage }, map, &model, None)?;
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
        match self.open_maps.with_closed(&name, retelling).await {
            Ok(()) => JobOutcome::Stored(end),
            Err(error) => JobOutcome::Failed(error),
        }
    }
}

fn retold_meanwhile() -> ServiceError {
    ServiceError::Aborted { message: "sessions were removed from the map meanwhile; try again".to_owned() }
}
