//! A map that is to have so many places only, and what was removed wiped from the disk.

use std::collections::BTreeSet;
use std::sync::Arc;

use tokio::runtime::Handle;
use topomap::budget::{Budgeted, Dispensable, over_budget};
use topomap::retelling::without_places;

use super::changed;
use super::source::ReadMap;
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::service::Service;
use crate::service::jobs::{JobOutcome, JobReporter, JobStatus, Stopped};
use crate::service::names::{map_in, map_name};
use crate::storage::{JobKind, MapRow, RetoldLog, Storage, StorageError};

/// What is asked of a map with too many places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trimming {
    /// Only say which would go.
    Preview,
    Apply,
}

/// Places that go, and why; and how many places more than asked for stay.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Trimmed {
    pub(crate) dropped: Vec<Dispensable>,
    pub(crate) places_left: u64,
    pub(crate) over: u64,
}

impl Service {
    /// Makes what a map holds now its new beginning, and wipes from the disk what was removed.
    pub(crate) async fn compact_map(self: &Arc<Self>, name: &str) -> Result<JobStatus, ServiceError> {
        let map = self.map_row(map_in(name)?).await?;
        let work = |service: Arc<Self>, reporter: JobReporter| async move {
            let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
            // The last moment to stop.
            if Stopped::unless(reporter.progress("writing the database anew", 0.0)).is_err() {
                return JobOutcome::Cancelled;
            }
            let compacted = async {
                service.storage.end_undoing(map.id).await?;
                service.storage.wipe_deleted().await?;
                let end = reporter.succeeded(map_name(&map.name));
                service.storage.end_job(&end).await?;
                Ok::<_, StorageError>(end)
            };
            match compacted.await {
                Ok(end) => JobOutcome::Stored { end, model: None },
                Err(StorageError::InUse) => JobOutcome::Failed(ServiceError::unavailable(
                    "what was removed is still in the write-ahead log, which somebody reads: wait until exports have \
                     ended, and compact the map again",
                )),
                Err(error) => JobOutcome::Failed(error.into()),
            }
        };
        self.start_job(JobKind::CompactMap, work).await
    }

    /// Drops the places that a map can do without, until it has no more than so many.
    pub(crate) async fn trim_map(
        self: &Arc<Self>,
        name: &str,
        most_places: u32,
        trimming: Trimming,
    ) -> Result<Trimmed, ServiceError> {
        if most_places == 0 {
            return Err(ServiceError::invalid("a map keeps at least one place; delete it if you want none"));
        }
        let map = self.map_row(map_in(name)?).await?;
        let model = self.loaded_model(&map.model).await?;
        let storage = self.storage.clone();
        match trimming {
            Trimming::Preview => {
                let runtime = Handle::current();
                let look = move || dispensable(&runtime, &storage, map, &model, most_places);
                let looked = tokio::task::spawn_blocking(look).await.map_err(ServiceError::internal)??;
                Ok(looked.1)
            }
            Trimming::Apply => {
                self.check_nobody_is_led(&map)?;
                let (service, name) = (self.clone(), map.name.clone());
                let trim = move |runtime: &Handle| {
                    service.check_nobody_is_led(&map)?;
                    let (read, trimmed) = dispensable(runtime, &storage, map, &model, most_places)?;
                    if !trimmed.dropped.is_empty() {
                        drop_places(runtime, &storage, &read, &trimmed)?;
                    }
                    Ok(trimmed)
                };
                self.with_map_closed(&name, trim).await
            }
        }
    }
}

/// Blocks.
fn dispensable(
    runtime: &Handle,
    storage: &Storage,
    map: MapRow,
    model: &LoadedModel,
    most_places: u32,
) -> Result<(ReadMap, Trimmed), ServiceError> {
    let read = ReadMap::read((runtime, storage), map, model, None)?;
    let Budgeted { dropped, over } = over_budget(&read.mapper, &read.log.events, most_places as usize);
    let places = read.mapper.map().places().len();
    let trimmed = Trimmed { places_left: (places - dropped.len()) as u64, over: over as u64, dropped };
    Ok((read, trimmed))
}

/// Frames at the places stay, at no place. Blocks.
fn drop_places(
    runtime: &Handle,
    storage: &Storage,
    read: &ReadMap,
    trimmed: &Trimmed,
) -> Result<(), ServiceError> {
    let dropped: BTreeSet<_> = trimmed.dropped.iter().map(|dropped| dropped.place).collect();
    let retold = without_places(read.mapper.settings(), &read.log.events, &dropped);
    let log = RetoldLog::new(read.row.edition(), &read.log.events, retold.map_err(ServiceError::internal)?);
    runtime.block_on(storage.retell(&log, None, None)).map_err(changed)
}
