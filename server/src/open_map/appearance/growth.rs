//! How the graph of a map comes to be: from the log and the stored features, and from what is kept of it on the disk.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use crate::ingest::FeatureRecord;
use fabmap::appearance::PlaceId;
use tokio::runtime::Handle;
use tokio::sync::{Mutex, OwnedMutexGuard};
use tokio_util::sync::CancellationToken;
use topomap::ids::FrameId;

use super::graph::{Graph, Shown};
use crate::error::ServiceError;
use crate::ingest::model::LoadedModel;
use crate::ingest::panoramic::PanoramicOptics;
use crate::storage::{KeptLinks, MapEdition, Storage, StorageError, StoredFeatures};

/// To be raised when the same panoramas would come to other links: by other candidates, another comparison or another
/// threshold. Links that were kept by other rules are found again.
const LINK_RULES: u32 = 1;

/// Places that are taken in before others see them.
const PIECE: u32 = 64;

/// Places whose links go to the disk together: a write for each would be in the way of the robots' frames.
const KEPT_TOGETHER: u32 = 16;

/// The graph of an open map.
#[derive(Debug, Default)]
pub(crate) struct GrowingGraph {
    growth: Arc<Mutex<Growth>>,
    /// What the others see.
    latest: RwLock<Option<Arc<Graph>>>,
    /// Whether a task is about to let it grow.
    wanted: AtomicBool,
    memory_bytes: AtomicU64,
}

/// How far the graph is.
#[derive(Debug, Default)]
struct Growth {
    graph: Arc<Graph>,
    /// Places below are taken in.
    next_place: PlaceId,
    /// What is on the disk; not looked at before the graph begins to grow. Without links once they are taken in.
    kept: Option<KeptLinks>,
}

/// What a graph grows from.
#[derive(Clone)]
pub(crate) struct Ground {
    pub(crate) storage: Storage,
    pub(crate) runtime: Handle,
    pub(crate) map: MapEdition,
    pub(crate) model: Arc<LoadedModel>,
    pub(crate) stopping: CancellationToken,
}

impl GrowingGraph {
    /// The graph with all places that the log has by now.
    pub(crate) async fn up_to_date(self: &Arc<Self>, ground: Ground) -> Result<Arc<Graph>, ServiceError> {
        self.grow(ground).await?;
        let latest = self.latest.read().unwrap_or_else(PoisonError::into_inner).clone();
        latest.ok_or_else(|| ServiceError::internal("a graph that has grown is not there"))
    }

    /// The graph if it is to grow and nobody is about to let it.
    pub(crate) fn wanted(self: &Arc<Self>) -> Option<Arc<Self>> {
        (!self.wanted.swap(true, Ordering::AcqRel)).then(|| self.clone())
    }

    /// Takes in what the log has by now, off the async threads and beside the map's writer.
    pub(crate) async fn grow(self: &Arc<Self>, ground: Ground) -> Result<(), ServiceError> {
        let growth = self.growth.clone().lock_owned().await;
        // What comes from now on may not be seen here.
        self.wanted.store(false, Ordering::Release);
        let graph = self.clone();
        let growing = tokio::task::spawn_blocking(move || graph.take_in(&ground, growth));
        growing.await.map_err(ServiceError::internal)?
    }

    /// What the views and their index take.
    pub(crate) fn memory_bytes(&self) -> u64 {
        self.memory_bytes.load(Ordering::Relaxed)
    }

    fn take_in(&self, ground: &Ground, mut growth: OwnedMutexGuard<Growth>) -> Result<(), ServiceError> {
        let Growth { graph, next_place, kept } = &mut *growth;
        let kept = match kept {
            Some(kept) => kept,
            None => kept.insert(ground.kept_links()?),
        };
        loop {
            let places = ground.storage.first_frames(ground.map.map, *next_place, PIECE);
            let places = ground.runtime.block_on(places)?;
            if !places.is_empty() {
                // The others keep what they see.
                let growing = Arc::make_mut(graph);
                for &(place, frame) in &places {
                    if ground.stopping.is_cancelled() {
                        return Err(ServiceError::stopping());
                    }
                    match (ground.panorama(frame)?, kept.links_of(place)) {
                        (Some(shown), Some(links)) => growing.restore(place, shown, links),
                        (Some(shown), None) => growing.add(place, shown),
                        (None, _) => {}
                    }
                    *next_place = place + 1;
                }
            }
            self.memory_bytes.store(graph.memory_bytes(), Ordering::Relaxed);
            *self.latest.write().unwrap_or_else(PoisonError::into_inner) = Some(graph.clone());
            if *next_place >= kept.next_place {
                kept.links = Vec::new();
            }
            if *next_place >= kept.next_place + KEPT_TOGETHER {
                ground.keep(graph, *next_place, kept);
            }
            if places.len() < PIECE as usize {
                return Ok(());
            }
        }
    }
}

impl Ground {
    fn kept_links(&self) -> Result<KeptLinks, ServiceError> {
        Ok(self.runtime.block_on(self.storage.kept_links(self.map.map, LINK_RULES))?)
    }

    /// Keeps the links of all places below `next_place`. If that fails, they are found again when the map is next opened.
    fn keep(&self, graph: &Graph, next_place: PlaceId, kept: &mut KeptLinks) {
        let links = graph.links_of_places(kept.next_place..next_place).collect();
        let more = KeptLinks { next_place, links };
        let written = self.storage.keep_links(self.map, LINK_RULES, kept.next_place, &more);
        match self.runtime.block_on(written) {
            Ok(()) => kept.next_place = next_place,
            // Rewritten or deleted, or opened again and grown further there: this one is about to go.
            Err(StorageError::Retold | StorageError::Exists) => {}
            Err(error) => {
                tracing::warn!(map = self.map.map, %error, "the links of an appearance graph could not be kept");
            }
        }
    }

    /// What a frame shows all around; none if its camera does not, or its features are not kept.
    fn panorama(&self, frame: FrameId) -> Result<Option<Shown>, ServiceError> {
        let stored = self.runtime.block_on(self.storage.features(self.map.map, frame))?;
        let Some(StoredFeatures { features, camera }) = stored else { return Ok(None) };
        let Some(optics) = camera.as_ref().and_then(PanoramicOptics::of_camera) else { return Ok(None) };
        let features = match FeatureRecord::from_bytes(&features) {
            Ok(features) => features,
            Err(error) => {
                tracing::error!(map = self.map.map, frame, %error, "a frame's features cannot be read; its place is no node");
                return Ok(None);
            }
        };
        Shown::new(&self.model, &optics, &features)
    }
}
