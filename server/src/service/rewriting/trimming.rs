//! A map that is to have so many places only.

use std::collections::BTreeSet;

use tokio::runtime::Handle;
use topomap::rewriting::{Budgeted, Dispensable, over_budget, without_places};

use super::{Rewriting, changed};
use crate::error::ServiceError;
use crate::ingest::model::LoadedModel;
use crate::names::map_in;
use crate::service::read_map::{Disk, ReadMap};
use crate::storage::{MapRow, RetoldLog};

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
    pub(crate) remaining_places: u64,
    pub(crate) excess_places: u64,
}

impl Rewriting {
    /// Drops the places that a map can do without, until it has no more than so many.
    pub(crate) async fn trim(
        &self,
        name: &str,
        most_places: u32,
        trimming: Trimming,
    ) -> Result<Trimmed, ServiceError> {
        if most_places == 0 {
            return Err(ServiceError::invalid("a map keeps at least one place; delete it if you want none"));
        }
        let map = self.open_maps.row(map_in(name)?).await?;
        let model = self.models.get(&map.model).await?;
        let storage = self.storage.clone();
        match trimming {
            Trimming::Preview => {
                let runtime = Handle::current();
                let look = move || {
                    dispensable(Disk { runtime: &runtime, storage: &storage }, map, &model, most_places)
                };
                let looked = tokio::task::spawn_blocking(look).await.map_err(ServiceError::internal)??;
                Ok(looked.1)
            }
            Trimming::Apply => {
                self.check_nobody_is_led(&map)?;
                let rewriting = self.clone();
                let name = map.name.clone();
                let trim = move |runtime: &Handle| {
                    rewriting.check_nobody_is_led(&map)?;
                    let disk = Disk { runtime, storage: &storage };
                    let (read, trimmed) = dispensable(disk, map, &model, most_places)?;
                    if !trimmed.dropped.is_empty() {
                        drop_places(disk, &read, &trimmed)?;
                    }
                    Ok(trimmed)
                };
                self.open_maps.with_closed(&name, trim).await
            }
        }
    }
}

/// Blocks.
fn dispensable(
    disk: Disk<'_>,
    map: MapRow,
    model: &LoadedModel,
    most_places: u32,
) -> Result<(ReadMap, Trimmed), ServiceError> {
    let read = ReadMap::read(disk, map, model, None)?;
    let Budgeted { dropped, over } = over_budget(&read.mapper, &read.log.events, most_places as usize);
    let places = read.mapper.map().places().len();
    let trimmed =
        Trimmed { remaining_places: (places - dropped.len()) as u64, excess_places: over as u64, dropped };
    Ok((read, trimmed))
}

/// Frames at the places stay, at no place. Blocks.
fn drop_places(disk: Disk<'_>, read: &ReadMap, trimmed: &Trimmed) -> Result<(), ServiceError> {
    let dropped: BTreeSet<_> = trimmed.dropped.iter().map(|dropped| dropped.place).collect();
    let retold = without_places(read.mapper.settings(), &read.log.events, &dropped);
    let log = RetoldLog::new(read.row.edition(), &read.log.events, retold.map_err(ServiceError::internal)?);
    disk.runtime.block_on(disk.storage.retell(&log, None, None)).map_err(changed)
}
