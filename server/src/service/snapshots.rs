//! Snapshots: a map with its model as one checksummed file, out and in.

mod check;
mod export;
mod format;
mod import;

use std::sync::Arc;

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::deleted_maps::DeletedMaps;
use super::jobs::Jobs;
use super::map_names::MapNames;
use crate::storage::{EXPORTERS, Storage};

/// Maps out and in as files. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Snapshots {
    storage: Storage,
    jobs: Jobs,
    names: MapNames,
    deleted_maps: DeletedMaps,
    stopping: CancellationToken,
    exports: Arc<Semaphore>,
    uploads: Arc<Semaphore>,
}

impl Snapshots {
    pub(super) fn new(
        storage: Storage,
        jobs: Jobs,
        names: MapNames,
        deleted_maps: DeletedMaps,
        stopping: CancellationToken,
    ) -> Self {
        Self {
            storage,
            jobs,
            names,
            deleted_maps,
            stopping,
            exports: Arc::new(Semaphore::new(EXPORTERS as usize)),
            uploads: Arc::new(Semaphore::new(import::MAX_IMPORTS)),
        }
    }
}
