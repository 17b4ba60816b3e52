//! Maps whose logs are written again: without some sessions, without some places, without what was removed before. And maps
//! that go altogether.

mod deletion;
mod removal;
mod trimming;

use std::sync::Arc;

use super::deleted_maps::DeletedMaps;
use super::jobs::{Begun, JobOutcome, JobReporter, JobRequest, JobStatus, Jobs, Stopped, Task};
use super::navigation::Registry;
use super::tokens::Caller;
use crate::error::ServiceError;
use crate::ingest::model::LoadedModels;
use crate::names::{map_in, map_name};
use crate::open_map::OpenMaps;
use crate::storage::{JobKind, MapRow, Storage, StorageError};

pub(crate) use self::trimming::{Trimmed, Trimming};

/// Writes the logs of maps again. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Rewriting {
    pub(super) storage: Storage,
    pub(super) models: LoadedModels,
    pub(super) open_maps: OpenMaps,
    pub(super) jobs: Jobs,
    pub(super) led: Arc<Registry>,
    pub(super) deleted_maps: DeletedMaps,
}

impl Rewriting {
    /// Makes what a map holds now its new beginning, and wipes from the disk what was removed.
    pub(crate) async fn compact(&self, caller: &Caller, name: &str) -> Result<JobStatus, ServiceError> {
        self.start_compacting(caller, name, Begun::Now).await
    }

    pub(super) async fn start_compacting(
        &self,
        caller: &Caller,
        name: &str,
        begun: Begun,
    ) -> Result<JobStatus, ServiceError> {
        caller.check_resource(name)?;
        let map = self.open_maps.row(map_in(name)?).await?;
        let rewriting = self.clone();
        let request = JobRequest {
            kind: JobKind::CompactMap,
            maps: vec![map.name.clone()],
            task: Some(Task::CompactMap { map: name.to_owned(), asked_by: caller.token.clone() }),
            begun,
        };
        let work = move |reporter: JobReporter| async move {
            let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
            // The last moment to stop.
            if Stopped::unless(reporter.progress("rewriting the database", 0.0)).is_err() {
                return JobOutcome::Cancelled;
            }
            let compacted = async {
                rewriting.storage.end_undoing(map.id).await?;
                rewriting.storage.wipe_deleted().await?;
                rewriting.storage.sweep_media().await?;
                let end = reporter.succeeded(map_name(&map.name));
                rewriting.storage.end_job(&end).await?;
                Ok::<_, StorageError>(end)
            };
            match compacted.await {
                Ok(end) => JobOutcome::Stored(end),
                Err(StorageError::InUse) => JobOutcome::Failed(ServiceError::unavailable(
                    "what was removed is still in the write-ahead log, which somebody reads: wait until exports have \
                     ended, and compact the map again",
                )),
                Err(error) => JobOutcome::Failed(error.into()),
            }
        };
        self.jobs.start(request, work).await
    }

    /// Places may have other numbers afterwards: a robot must not end up at another place than it was sent to.
    pub(super) fn check_nobody_is_led(&self, map: &MapRow) -> Result<(), ServiceError> {
        if !self.led.any_on(map.id) {
            return Ok(());
        }
        Err(ServiceError::precondition(format_args!(
            "robots are being led through the map {}, or were a minute ago; end that first: places may have other numbers \
             afterwards",
            map.name
        )))
    }
}

/// A source that is no longer what the merge was looked for with.
pub(super) fn changed(error: StorageError) -> ServiceError {
    match error {
        StorageError::Retold => ServiceError::Aborted {
            message: "a map was deleted, or sessions were removed from it, since it was looked at; ask for the merge again"
                .to_owned(),
        },
        StorageError::JobEnded => ServiceError::Aborted {
            message: "the merge was decided otherwise meanwhile; look at it, and ask for it again if need be".to_owned(),
        },
        error => error.into(),
    }
}
