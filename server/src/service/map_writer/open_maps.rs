//! Which maps are open, and how one is opened from the disk.

use std::collections::{BTreeSet, HashMap};
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use tokio::runtime::Handle;
use tokio::sync::{Mutex as AsyncMutex, mpsc};
use topomap::event::MapEvent;
use topomap::mapper::Mapper;

use super::MapWriter;
use super::requests::{MapHandle, QUEUE};
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::service::{Service, map_settings};
use crate::storage::{Checkpoint, LogEntry, MapRow, Storage, StorageError};

/// A map's place among the open ones: locked while it is being opened, closed or deleted.
#[derive(Debug, Default)]
struct Slot {
    open: Option<(MapHandle, JoinHandle<()>)>,
}

/// The maps in memory, by name.
#[derive(Debug, Default)]
pub(crate) struct OpenMaps {
    slots: Mutex<HashMap<String, Arc<AsyncMutex<Slot>>>>,
}

impl OpenMaps {
    /// Runs `work` while the map is closed and cannot be opened.
    pub(crate) async fn while_closed<T>(&self, map: &str, work: impl Future<Output = T>) -> T {
        let slot = self.slot(map);
        let mut slot = slot.lock().await;
        slot.close().await;
        work.await
    }

    /// Commits, checkpoints and closes every map.
    pub(crate) async fn close_all(&self) {
        let slots: Vec<_> = self.slots.lock().unwrap_or_else(PoisonError::into_inner).drain().collect();
        for (_, slot) in slots {
            slot.lock().await.close().await;
        }
    }

    fn slot(&self, map: &str) -> Arc<AsyncMutex<Slot>> {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots.entry(map.to_owned()).or_default().clone()
    }
}

impl Slot {
    async fn close(&mut self) {
        let Some((handle, thread)) = self.open.take() else { return };
        handle.close().await;
        let joined = tokio::task::spawn_blocking(move || thread.join()).await;
        if !matches!(joined, Ok(Ok(()))) {
            tracing::error!("a map's writer panicked; what it had acknowledged is in the log");
        }
    }
}

impl Service {
    /// A map's writer; opens the map from the disk if need be.
    pub(crate) async fn open_map(&self, name: &str) -> Result<MapHandle, ServiceError> {
        if self.stopping.is_cancelled() {
            return Err(ServiceError::stopping());
        }
        let slot = self.open_maps.slot(name);
        let mut slot = slot.lock().await;
        if let Some((handle, _)) = slot.open.as_ref().filter(|(handle, _)| !handle.is_gone()) {
            return Ok(handle.clone());
        }
        slot.close().await;
        let row = self.map_row(name).await?;
        let model = self.loaded_model(&row.model).await?;
        let (storage, runtime) = (self.storage.clone(), Handle::current());
        let opened = tokio::task::spawn_blocking(move || open(runtime, storage, row, model)).await;
        let opened = opened.map_err(ServiceError::internal)??;
        let handle = opened.0.clone();
        slot.open = Some(opened);
        Ok(handle)
    }
}

/// Opens a map from its checkpoint and what the log has since, and starts its writer. Blocks.
fn open(
    runtime: Handle,
    storage: Storage,
    map: MapRow,
    model: Arc<LoadedModel>,
) -> Result<(MapHandle, JoinHandle<()>), ServiceError> {
    let mut mapper = restore(&runtime, &storage, &map, &model)?;
    let checkpoint_events = mapper.map().events();
    let mut changed = BTreeSet::new();
    let mut fold = |LogEntry { event, .. }: LogEntry| {
        if let MapEvent::Frame(frame) = &event {
            changed.extend(frame.decision.place.filter(|_| frame.learnt));
        }
        mapper.apply(&event).map_err(|error| StorageError::Damaged(error.to_string()))
    };
    let words = model.model.vocabulary().len();
    runtime.block_on(storage.replay(map.id, checkpoint_events, words, &mut fold))?;
    let sessions = runtime.block_on(storage.sessions(map.id))?;
    let events = mapper.map().events();
    tracing::info!(map = map.name, events, replayed = events - checkpoint_events, "map opened");
    let (sender, receiver) = mpsc::channel(QUEUE);
    let handle = MapHandle::new(map.id, sender);
    let thread = std::thread::Builder::new().name(format!("map-{}", map.id));
    let (streams, pending) = (HashMap::new(), Vec::new());
    let writer = MapWriter {
        map,
        model,
        mapper,
        storage,
        runtime,
        sessions,
        streams,
        pending,
        changed,
        checkpoint_events,
    };
    let thread = thread.spawn(move || writer.run(receiver)).map_err(ServiceError::internal)?;
    Ok((handle, thread))
}

/// The map as of its checkpoint; an empty one, to be filled from the log, if there is none to use.
fn restore(
    runtime: &Handle,
    storage: &Storage,
    map: &MapRow,
    model: &LoadedModel,
) -> Result<Mapper, ServiceError> {
    let settings = map_settings::from_json(&map.settings)?;
    let unusable = match runtime.block_on(storage.checkpoint(map.id)) {
        Ok(None) => None,
        Ok(Some(Checkpoint { graph, places })) => {
            match Mapper::restore(&model.model, settings, places.iter().map(Vec::as_slice), &graph) {
                Ok(mapper) => return Ok(mapper),
                Err(error) => Some(error.to_string()),
            }
        }
        Err(StorageError::Damaged(why)) => Some(why),
        Err(error) => return Err(error.into()),
    };
    if let Some(why) = unusable {
        tracing::warn!(
            map = map.name,
            why,
            "the checkpoint cannot be used; the map is replayed from its log"
        );
        runtime.block_on(storage.delete_checkpoint(map.id))?;
    }
    Mapper::new(&model.model, settings).map_err(ServiceError::internal)
}
