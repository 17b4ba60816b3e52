//! Which maps are open, and how one is opened from the disk.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use tokio::runtime::Handle;
use tokio::sync::{Mutex as AsyncMutex, mpsc};
use topomap::event::{MapEvent, SessionId};
use topomap::mapper::Mapper;
use tracing::Span;

use super::localizers::Localizers;
use super::recent::Recent;
use super::requests::{MapHandle, QUEUE};
use super::views::verifier;
use super::{MOST_RECENT, MOST_RECENT_FEATURES, MapWriter};
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::metrics::Metrics;
use crate::service::camera::Intrinsics;
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
    /// Commits, checkpoints and closes every map.
    pub(crate) async fn close_all(&self) {
        let slots: Vec<_> = self.slots().drain().collect();
        for (_, slot) in slots {
            slot.lock().await.close().await;
        }
    }

    /// How many maps are in memory. One that is just being opened or closed is not waited for.
    pub(crate) fn count(&self) -> usize {
        let slots = self.slots();
        let open = |slot: &&Arc<AsyncMutex<Slot>>| slot.try_lock().is_ok_and(|slot| slot.handle().is_some());
        slots.values().filter(open).count()
    }

    fn slot(&self, map: &str) -> Arc<AsyncMutex<Slot>> {
        self.slots().entry(map.to_owned()).or_default().clone()
    }

    fn slots(&self) -> MutexGuard<'_, HashMap<String, Arc<AsyncMutex<Slot>>>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Slot {
    fn handle(&self) -> Option<MapHandle> {
        self.open.as_ref().map(|(handle, _)| handle.clone()).filter(|handle| !handle.is_gone())
    }

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
    pub(crate) async fn open_map(self: &Arc<Self>, name: &str) -> Result<MapHandle, ServiceError> {
        // Asked first, so that names that are no maps leave nothing behind.
        self.map_row(name).await?;
        let mut slot = self.open_maps.slot(name).lock_owned().await;
        // Looked at under the lock: a map opened later than this would never be closed.
        if self.stopping.is_cancelled() {
            return Err(ServiceError::stopping());
        }
        // Asked again: while the lock was waited for, the map may have been deleted or bound to another model.
        let row = self.map_row(name).await?;
        if let Some(handle) = slot.handle().filter(|handle| handle.id() == row.id) {
            return Ok(handle);
        }
        let (service, span) = (self.clone(), Span::current());
        // A task of its own: whoever asked may go away, but a map must not be left half open, or a
        // second writer could be started beside the first.
        let opening = tokio::spawn(async move {
            slot.close().await;
            let model = service.loaded_model(&row.model).await?;
            let (storage, runtime) = (service.storage.clone(), Handle::current());
            let metrics = service.metrics.clone();
            let opening = move || span.in_scope(|| open(runtime, storage, metrics, row, model));
            let opened = tokio::task::spawn_blocking(opening).await;
            let opened = opened.map_err(ServiceError::internal)??;
            let handle = opened.0.clone();
            slot.open = Some(opened);
            Ok(handle)
        });
        opening.await.map_err(ServiceError::internal)?
    }

    /// The writer of the very map that `row` is of. What was prepared by its model must not come to another
    /// map that has its name by now: the words of that may mean something else. A map that was bound to
    /// another model meanwhile is still the same, and so are its words.
    pub(crate) async fn open_map_of(self: &Arc<Self>, row: &MapRow) -> Result<MapHandle, ServiceError> {
        let open = self.open_map(&row.name).await?;
        if open.id() == row.id {
            return Ok(open);
        }
        Err(ServiceError::not_found(format_args!(
            "the map {} was deleted just now, and another of its name made; ask again if you mean that one",
            row.name
        )))
    }

    /// Closes a map and binds it to another model, whether or not whoever asked is still there. Streams go
    /// on: their next frame opens it again.
    pub(crate) async fn close_and_rebind_map(
        self: &Arc<Self>,
        name: &str,
        model: String,
    ) -> Result<(), ServiceError> {
        let row = self.map_row(name).await?;
        let mut slot = self.open_maps.slot(name).lock_owned().await;
        let service = self.clone();
        let rebinding = tokio::spawn(async move {
            slot.close().await;
            service.storage.rebind_map(row.id, &model).await
        });
        match rebinding.await.map_err(ServiceError::internal)? {
            Ok(()) => Ok(()),
            Err(StorageError::InUse) => {
                Err(ServiceError::not_found("the model was deleted just now; name another"))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Closes a map and deletes it, whether or not whoever asked is still there. Whether there was one.
    /// Its name is free at once; its rows are taken away in the background.
    pub(crate) async fn close_and_delete_map(self: &Arc<Self>, name: &str) -> Result<bool, ServiceError> {
        let mut slot = self.open_maps.slot(name).lock_owned().await;
        let (service, name) = (self.clone(), name.to_owned());
        let deleting = tokio::spawn(async move {
            slot.close().await;
            // The slot stays: whoever waits for its lock must not end up beside a new one.
            let retired = service.storage.retire_map(&name).await;
            service.removal_wanted();
            retired
        });
        Ok(deleting.await.map_err(ServiceError::internal)??)
    }
}

/// Opens a map from its checkpoint and what the log has since, and starts its writer. Blocks.
fn open(
    runtime: Handle,
    storage: Storage,
    metrics: Metrics,
    map: MapRow,
    model: Arc<LoadedModel>,
) -> Result<(MapHandle, JoinHandle<()>), ServiceError> {
    let mut mapper = restore(&runtime, &storage, &map, &model)?;
    let checkpoint_events = mapper.map().events();
    let mut changed = BTreeSet::new();
    let mut fold = |LogEntry { position: _, event, media: _ }: LogEntry| {
        if let MapEvent::Frame(frame) = &event {
            changed.extend(frame.decision.place.filter(|_| frame.learnt));
        }
        mapper.apply(&event).map_err(|error| StorageError::Damaged(error.to_string()))
    };
    let words = model.model.vocabulary().len();
    runtime.block_on(storage.replay(map.id, checkpoint_events..u64::MAX, words, &mut fold))?;
    let sessions = runtime.block_on(storage.sessions(map.id))?;
    let cameras = runtime.block_on(storage.cameras(map.id))?;
    let known = |(session, camera): (SessionId, Vec<u8>)| Some((session, Intrinsics::of_camera(&camera)?));
    let intrinsics = cameras.into_iter().filter_map(known).collect();
    let events = mapper.map().events();
    tracing::info!(map = map.name, events, replayed = events - checkpoint_events, "map opened");
    let (sender, receiver) = mpsc::channel(QUEUE);
    let handle = MapHandle::new(map.id, sender);
    let thread = std::thread::Builder::new().name(format!("map-{}", map.id));
    let (streams, localizers, pending) = (HashMap::new(), Localizers::default(), Vec::new());
    let recent = RefCell::new(Recent::new(MOST_RECENT));
    let recent_features = RefCell::new(Recent::new(MOST_RECENT_FEATURES));
    let verifier = verifier(mapper.settings());
    let writer = MapWriter {
        map,
        model,
        mapper,
        storage,
        metrics,
        runtime,
        sessions,
        intrinsics,
        streams,
        localizers,
        pending,
        recent,
        recent_features,
        verifier,
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
    let settings = map_settings::from_json(&map.settings)?.mapper;
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
