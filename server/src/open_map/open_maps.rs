//! Which maps are open, and how one is opened from the disk.

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::{Mutex as AsyncMutex, mpsc};
use tokio_util::sync::CancellationToken;
use topomap::checkpoint::Changes;
use topomap::ids::SessionId;
use topomap::mapper::Mapper;
use tracing::Span;

use super::checkpoints::{Checkpoints, Layout, Unusable};
use super::handle::MapHandle;
use super::localizers::Localizers;
use super::recent::Recent;
use super::requests::QUEUE;
use super::tracking::MOST_TRACKERS;
use super::views::verifier;
use super::{MOST_RECENT, MOST_RECENT_FEATURES, MapWriter, checkpoints};
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::ingest::intrinsics::Intrinsics;
use crate::ingest::model::{LoadedModel, LoadedModels};
use crate::ingest::panoramic::PanoramicOptics;
use crate::map_settings;
use crate::metrics::Metrics;
use crate::storage::{MapRow, Storage, StorageError};

/// A map's place among the open ones: locked while it is being opened, closed or deleted.
#[derive(Debug, Default)]
struct Slot {
    open: Option<(MapHandle, JoinHandle<()>)>,
}

/// The maps in memory, and how to open others. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct OpenMaps {
    storage: Storage,
    models: LoadedModels,
    metrics: Metrics,
    /// Once it is cancelled, no map is opened.
    stopping: CancellationToken,
    /// By name.
    slots: Arc<Mutex<HashMap<String, Arc<AsyncMutex<Slot>>>>>,
}

impl OpenMaps {
    pub(crate) fn new(
        storage: Storage,
        models: LoadedModels,
        metrics: Metrics,
        stopping: CancellationToken,
    ) -> Self {
        Self { storage, models, metrics, stopping, slots: Arc::default() }
    }

    /// A map as the database has it.
    pub(crate) async fn row(&self, map: &str) -> Result<MapRow, ServiceError> {
        self.storage.map(map).await?.ok_or_else(|| no_such_map(map))
    }

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

    /// Requests that wait for the writers of the maps in memory.
    pub(crate) fn waiting_requests(&self) -> usize {
        self.usages().iter().map(|(_, handle)| handle.waiting_requests()).sum()
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

impl OpenMaps {
    /// Until the server stops, closes maps that nobody uses, and forgets their models, while open maps take more memory
    /// than `budget_bytes`.
    pub(crate) async fn keep_within(self, budget_bytes: u64) {
        loop {
            tokio::select! {
                () = tokio::time::sleep(UPKEEP) => {}
                () = self.stopping.cancelled() => return,
            }
            if self.close_unused(budget_bytes).await {
                self.models.forget_unused();
            }
        }
    }

    /// A map's writer; opens the map from the disk if need be.
    pub(crate) async fn open(&self, name: &str) -> Result<MapHandle, ServiceError> {
        // Asked first, so that names that are no maps leave nothing behind.
        self.row(name).await?;
        let mut slot = self.slot(name).lock_owned().await;
        // Looked at under the lock: a map opened later than this would never be closed.
        if self.stopping.is_cancelled() {
            return Err(ServiceError::stopping());
        }
        // Asked again: while the lock was waited for, the map may have been deleted or bound to another model.
        let row = self.row(name).await?;
        if let Some(handle) = slot.handle().filter(|handle| handle.id() == row.id) {
            return Ok(handle);
        }
        let Self { storage, models, metrics, .. } = self.clone();
        let span = Span::current();
        // A task of its own: the caller may go away, but a map must not be left half open, or a
        // second writer could be started beside the first.
        let opening = tokio::spawn(async move {
            slot.close().await;
            let model = models.get(&row.model).await?;
            let runtime = Handle::current();
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
    pub(crate) async fn open_of(&self, row: &MapRow) -> Result<MapHandle, ServiceError> {
        let open = self.open(&row.name).await?;
        if open.id() == row.id {
            return Ok(open);
        }
        Err(ServiceError::not_found(format_args!(
            "the map {} was deleted just now, and another of its name made; ask again if you mean that one",
            row.name
        )))
    }

    /// Closes a map and does something to its log, whether or not the caller is still there. Streams go on: their next
    /// frame opens it again.
    pub(crate) async fn with_closed<T: Send + 'static>(
        &self,
        name: &str,
        work: impl FnOnce(&Handle) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.row(name).await?;
        let mut slot = self.slot(name).lock_owned().await;
        let working = tokio::spawn(async move {
            slot.close().await;
            let runtime = Handle::current();
            let worked = tokio::task::spawn_blocking(move || work(&runtime)).await;
            worked.map_err(ServiceError::internal)?
        });
        working.await.map_err(ServiceError::internal)?
    }
}

/// Reads a map from the disk, and starts its writer. Blocks.
fn open(
    runtime: Handle,
    storage: Storage,
    metrics: Metrics,
    map: MapRow,
    model: Arc<LoadedModel>,
) -> Result<(MapHandle, JoinHandle<()>), ServiceError> {
    let (mapper, checkpoints) = read(&runtime, &storage, &map, &model)?;
    let sessions = runtime.block_on(storage.sessions(map.id))?;
    let cameras = runtime.block_on(storage.cameras(map.id))?;
    let intrinsics = by_session(&cameras, Intrinsics::of_camera);
    let around = by_session(&cameras, PanoramicOptics::of_camera);
    let (sender, receiver) = mpsc::channel(QUEUE);
    let handle = MapHandle::new(map.edition(), sender);
    let usage = handle.usage().clone();
    usage.set_memory_bytes(mapper.memory_bytes());
    let thread = std::thread::Builder::new().name(format!("map-{}", map.id));
    let streams = HashMap::new();
    let localizers = Localizers::default();
    let pending = Vec::new();
    let recent = RefCell::new(Recent::new(MOST_RECENT));
    let recent_features = RefCell::new(Recent::new(MOST_RECENT_FEATURES));
    let trackers = Recent::new(MOST_TRACKERS);
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
        trackers,
        verifier,
        checkpoints,
        usage,
    };
    let thread = thread.spawn(move || writer.run(receiver)).map_err(ServiceError::internal)?;
    Ok((handle, thread))
}

/// The map as of its checkpoint and what the log has since, and the checkpoint that it has by then.
fn read(
    runtime: &Handle,
    storage: &Storage,
    map: &MapRow,
    model: &LoadedModel,
) -> Result<(Mapper, Checkpoints), ServiceError> {
    let (mut mapper, layout) = restore(runtime, storage, map, model)?;
    let checkpoint_events = mapper.map().events();
    runtime.block_on(storage.check_log_reaches(map.id, checkpoint_events))?;
    let mut changes = Changes::since(mapper.map());
    let mut fold = |_: u64, event| {
        changes.follow(&event);
        mapper.fold(&event).map_err(|error| StorageError::Damaged(error.to_string()))
    };
    let words = model.model.vocabulary().len();
    runtime.block_on(storage.replay(map.id, checkpoint_events..u64::MAX, words, &mut fold))?;
    runtime.block_on(storage.check_owned())?;
    mapper.relax();
    let events = mapper.map().events();
    let checkpoints = match layout {
        Some(layout) => Checkpoints::new(changes, checkpoint_events, layout),
        None if events == 0 => Checkpoints::new(changes, 0, Layout::default()),
        None => first_checkpoint(runtime, storage, map, &mapper),
    };
    tracing::info!(map = map.name, events, replayed = events - checkpoint_events, "map opened");
    Ok((mapper, checkpoints))
}

/// What is made of the sessions' cameras, of those that are of that kind.
fn by_session<T>(
    cameras: &[(SessionId, Camera)],
    of_camera: impl Fn(&Camera) -> Option<T>,
) -> HashMap<SessionId, T> {
    cameras.iter().filter_map(|(session, camera)| Some((*session, of_camera(camera)?))).collect()
}

/// The map as of its checkpoint, and where that is; an empty one, to be filled from the log, if there is none to use.
fn restore(
    runtime: &Handle,
    storage: &Storage,
    map: &MapRow,
    model: &LoadedModel,
) -> Result<(Mapper, Option<Layout>), ServiceError> {
    let settings = map_settings::from_json(&map.settings)?.mapper;
    let view = match runtime.block_on(storage.view_checkpoint(map.id)) {
        Err(error @ StorageError::Rot(_)) => Err(Unusable::from(error)),
        view => Ok(view?),
    };
    let restored = view
        .and_then(|view| view.map(|view| checkpoints::restore(runtime, view, model, settings)).transpose());
    match restored {
        Ok(Some((mapper, layout))) => return Ok((mapper, Some(layout))),
        Ok(None) => {}
        Err(Unusable::Unread(error)) => return Err(error.into()),
        Err(Unusable::Damaged(why)) => tracing::warn!(
            map = map.name,
            why,
            "the checkpoint cannot be used; the map is replayed from its log"
        ),
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

pub(crate) fn no_such_map(map: &str) -> ServiceError {
    ServiceError::not_found(format_args!(
        "there is no map {map}; list the maps to see what there is, or create it"
    ))
}
