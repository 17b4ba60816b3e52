//! Which maps are open, and how one is opened from the disk.

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::{Mutex as AsyncMutex, mpsc};
use topomap::checkpoint::Changes;
use topomap::event::SessionId;
use topomap::mapper::Mapper;
use tracing::Span;

use super::checkpoints::{self, Checkpoints, Layout, Unusable};
use super::localizers::Localizers;
use super::recent::Recent;
use super::requests::{MapHandle, QUEUE};
use super::views::verifier;
use super::{MOST_RECENT, MOST_RECENT_FEATURES, MapWriter};
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::metrics::Metrics;
use crate::service::camera::{Intrinsics, PanoramicOptics};
use crate::service::{Service, map_settings};
use crate::storage::{LogEntry, MapRow, Storage, StorageError};

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

    /// Maps in memory with how they are used. One that is just being opened or closed is not waited for.
    fn usages(&self) -> Vec<(Arc<AsyncMutex<Slot>>, MapHandle)> {
        let handle = |slot: &Arc<AsyncMutex<Slot>>| slot.try_lock().ok()?.handle();
        self.slots().values().filter_map(|slot| Some((slot.clone(), handle(slot)?))).collect()
    }

    /// Closes maps that nobody uses, those first that were not asked for longest, until what is open takes no
    /// more than `budget_bytes`. Tells whether any was.
    async fn close_unused(&self, budget_bytes: u64) -> bool {
        let mut open = self.usages();
        open.sort_by_key(|(_, handle)| handle.usage().last_asked());
        let mut memory_bytes: u64 = open.iter().map(|(_, handle)| handle.memory_bytes()).sum();
        let mut closed = false;
        for (slot, handle) in open {
            let usage = handle.usage();
            if memory_bytes <= budget_bytes || usage.last_asked().elapsed() < UNUSED {
                break;
            }
            // Under the lock, so that who opens it again waits until it is closed.
            let Ok(mut slot) = slot.try_lock() else { continue };
            if handle.close_unused().await {
                memory_bytes -= handle.memory_bytes().min(memory_bytes);
                slot.close().await;
                closed = true;
            }
        }
        closed
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

/// A map that was not asked for so long is not used.
const UNUSED: Duration = Duration::from_secs(10);

/// How often maps that nobody uses are looked for.
const UPKEEP: Duration = Duration::from_secs(2);

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
    /// Closes maps that nobody uses, and forgets their models, while open maps take more memory than `budget_bytes`.
    pub(crate) fn start_closing_unused_maps(self: &Arc<Self>, budget_bytes: u64) {
        let service = self.clone();
        self.jobs.track(async move {
            loop {
                tokio::select! {
                    () = tokio::time::sleep(UPKEEP) => {}
                    () = service.stopping.cancelled() => return,
                }
                if service.open_maps.close_unused(budget_bytes).await {
                    service.cached_models().retain(|_, model| Arc::strong_count(model) > 1);
                }
            }
        });
    }

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

    /// Closes a map and binds it to another model.
    pub(crate) async fn close_and_rebind_map(
        self: &Arc<Self>,
        name: &str,
        model: String,
    ) -> Result<(), ServiceError> {
        let (map, storage) = (self.map_row(name).await?.id, self.storage.clone());
        let rebind = move |runtime: &Handle| match runtime.block_on(storage.rebind_map(map, &model)) {
            Ok(()) => Ok(()),
            Err(StorageError::InUse) => {
                Err(ServiceError::not_found("the model was deleted just now; name another"))
            }
            Err(error) => Err(error.into()),
        };
        self.with_map_closed(name, rebind).await
    }

    /// Closes a map and does something to its log, whether or not whoever asked is still there. Streams go on: their
    /// next frame opens it again.
    pub(crate) async fn with_map_closed<T: Send + 'static>(
        self: &Arc<Self>,
        name: &str,
        work: impl FnOnce(&Handle) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.map_row(name).await?;
        let mut slot = self.open_maps.slot(name).lock_owned().await;
        let working = tokio::spawn(async move {
            slot.close().await;
            let runtime = Handle::current();
            let worked = tokio::task::spawn_blocking(move || work(&runtime)).await;
            worked.map_err(ServiceError::internal)?
        });
        working.await.map_err(ServiceError::internal)?
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
    let (mut mapper, layout) = restore(&runtime, &storage, &map, &model)?;
    let checkpoint_events = mapper.map().events();
    let mut changes = Changes::since(mapper.map());
    let mut fold = |LogEntry { position: _, event, media: _ }: LogEntry| {
        changes.follow(&event);
        mapper.fold(&event).map_err(|error| StorageError::Damaged(error.to_string()))
    };
    let words = model.model.vocabulary().len();
    runtime.block_on(storage.replay(map.id, checkpoint_events..u64::MAX, words, &mut fold))?;
    mapper.relax();
    let checkpoints = match layout {
        Some(layout) => Checkpoints::new(changes, checkpoint_events, layout),
        None if mapper.map().events() == 0 => Checkpoints::new(changes, 0, Layout::default()),
        None => first_checkpoint(&runtime, &storage, &map, &mapper),
    };
    let sessions = runtime.block_on(storage.sessions(map.id))?;
    let cameras = runtime.block_on(storage.cameras(map.id))?;
    let known = |(session, camera): &(SessionId, Vec<u8>)| Some((*session, Intrinsics::of_camera(camera)?));
    let intrinsics = cameras.iter().filter_map(known).collect();
    let known =
        |(session, camera): &(SessionId, Vec<u8>)| Some((*session, PanoramicOptics::of_camera(camera)?));
    let around = cameras.iter().filter_map(known).collect();
    let events = mapper.map().events();
    tracing::info!(map = map.name, events, replayed = events - checkpoint_events, "map opened");
    let (sender, receiver) = mpsc::channel(QUEUE);
    let handle = MapHandle::new(map.edition(), sender);
    let usage = handle.usage().clone();
    usage.set_memory_bytes(mapper.memory_bytes());
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
        around,
        streams,
        localizers,
        pending,
        recent,
        recent_features,
        verifier,
        checkpoints,
        usage,
    };
    let thread = thread.spawn(move || writer.run(receiver)).map_err(ServiceError::internal)?;
    Ok((handle, thread))
}

/// The map as of its checkpoint, and where that is; an empty one, to be filled from the log, if there is none to use.
fn restore(
    runtime: &Handle,
    storage: &Storage,
    map: &MapRow,
    model: &LoadedModel,
) -> Result<(Mapper, Option<Layout>), ServiceError> {
    let settings = map_settings::from_json(&map.settings)?.mapper;
    if let Some(view) = runtime.block_on(storage.view_checkpoint(map.id))? {
        match checkpoints::restore(runtime, view, model, settings) {
            Ok((mapper, layout)) => return Ok((mapper, Some(layout))),
            Err(Unusable::Unread(error)) => return Err(error.into()),
            Err(Unusable::Damaged(why)) => tracing::warn!(
                map = map.name,
                why,
                "the checkpoint cannot be used; the map is replayed from its log"
            ),
        }
    }
    Ok((Mapper::new(&model.model, settings).map_err(ServiceError::internal)?, None))
}

/// Writes the checkpoint of a map that was replayed as a whole.
fn first_checkpoint(runtime: &Handle, storage: &Storage, map: &MapRow, mapper: &Mapper) -> Checkpoints {
    match checkpoints::write_first(runtime, storage, map.id, mapper) {
        Ok(layout) => Checkpoints::new(Changes::since(mapper.map()), mapper.map().events(), layout),
        Err(error) => {
            tracing::warn!(map = map.name, %error, "no checkpoint was written; the log has it all");
            Checkpoints::none()
        }
    }
}
