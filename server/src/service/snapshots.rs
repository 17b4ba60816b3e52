//! Snapshots: a map with its model as one checksummed file, out and in.

mod check;
mod export;
mod format;
mod import;

use std::fs::File;
use std::ops::ControlFlow;
use std::sync::Arc;

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use self::check::{NotTaken, check, map_of};
use super::deleted_maps::DeletedMaps;
use super::jobs::Jobs;
use super::map_names::MapNames;
use crate::error::ServiceError;
use crate::names::check_id;
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

/// Checks a file as an import does, and stores nothing.
///
/// # Errors
/// Why an import would not take it.
pub(crate) fn would_import(file: &File) -> Result<(), ServiceError> {
    let checked = map_of(file).and_then(|map| {
        check_id("map name", &map.name)?;
        check(file, &map.name, &mut |_| ControlFlow::Continue(()))
    });
    match checked {
        Ok(_map) => Ok(()),
        Err(NotTaken::Refused(error)) => Err(error),
        Err(NotTaken::Cancelled) => Err(ServiceError::internal("nobody cancels this")),
    }
}
