//! The graph of a map, as it grows: a node for each place, whose image is the panorama that made the place.
//!
//! It hangs on the log and the stored features alone, taken in the order of places: however often it is built, and in
//! however many pieces, it comes out the same. Nothing of it is on the disk.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

use fabmap::appearance::PlaceId;
use tokio::runtime::Handle;
use tokio::sync::{Mutex, OwnedMutexGuard};
use tokio_util::sync::CancellationToken;
use topomap::appearance_graph::candidates::{CandidateIndex, IndexedFeature};
use topomap::appearance_graph::{AppearanceGraph, Checks, ImageId, Overlap, Panorama};
use topomap::epipolar::SearchSettings;
use topomap::event::FrameId;
use topomap::mapper::{ArchiveError, FrameError};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::panorama::PanoramicView;

use super::LinkView;
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::service::camera::PanoramicOptics;
use crate::storage::{MapId, Storage, StoredFeatures};

/// Images that the index names to a robot that is lost.
const MAX_NAMED: usize = 64;

/// Places that are taken in before others see them.
const PIECE: u32 = 64;

/// What a graph grows from.
#[derive(Clone)]
pub(crate) struct Ground {
    pub(super) storage: Storage,
    pub(super) runtime: Handle,
    pub(super) map: MapId,
    pub(super) model: Arc<LoadedModel>,
    pub(super) stopping: CancellationToken,
}

/// Places and what their panoramas have in common, at some moment.
#[derive(Clone, Debug)]
pub(crate) struct Graph {
    /// By image, rising: places without a panorama have none.
    places: Vec<PlaceId>,
    views: Vec<Arc<PanoramicView>>,
    index: CandidateIndex,
    links: AppearanceGraph,
    spaces: OnceLock<Vec<u32>>,
}

/// The graph of an open map.
#[derive(Debug, Default)]
pub(crate) struct GrowingGraph {
    growth: Arc<Mutex<Growth>>,
    /// What the others see.
    latest: RwLock<Option<Arc<Graph>>>,
    /// Whether somebody is about to let it grow.
    wanted: AtomicBool,
    memory_bytes: AtomicU64,
}

/// How far the graph is.
#[derive(Debug, Default)]
struct Growth {
    graph: Option<Arc<Graph>>,
    /// Places below are taken in.
    next_place: PlaceId,
}

/// A panorama as it is compared, and as the index has it.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub(crate) view: Arc<PanoramicView>,
    indexed: Vec<IndexedFeature>,
}

/// A panorama that comes to the graph.
struct Coming<'a> {
    view: &'a PanoramicView,
    earlier: &'a [Arc<PanoramicView>],
}

impl Panorama for Coming<'_> {
    fn overlap(&self, image: ImageId) -> Result<Option<Overlap>, ArchiveError> {
        Ok(self.view.compare(&self.earlier[image as usize], &SearchSettings::default()).overlap)
    }
}

impl Shown {
    /// None if the features came without descriptors, or lie in no panorama.
    pub(crate) fn new(
        model: &LoadedModel,
        optics: &PanoramicOptics,
        features: &FeatureRecord,
    ) -> Result<Option<Self>, ServiceError> {
        let Some(view) = optics.view(features) else { return Ok(None) };
        let signed = model.signatures().sign(features.words(), view.descriptors());
        let signed = signed.map_err(ServiceError::internal)?.into_iter();
        let indexed = signed.zip(view.rays()).map(|(word, ray)| IndexedFeature::new(word, ray)).collect();
        Ok(Some(Self { view: Arc::new(view), indexed }))
    }
}

impl Graph {
    fn empty() -> Self {
        Self {
            places: Vec::new(),
            views: Vec::new(),
            index: CandidateIndex::default(),
            links: AppearanceGraph::default(),
            spaces: OnceLock::new(),
        }
    }

    /// By image, rising.
    pub(crate) fn places(&self) -> &[PlaceId] {
        &self.places
    }

    /// The image of a place; none if no panorama made it.
    pub(crate) fn image_of(&self, place: PlaceId) -> Option<ImageId> {
        self.places.binary_search(&place).ok().map(|image| image as ImageId)
    }

    pub(crate) fn place_of(&self, image: ImageId) -> Option<PlaceId> {
        self.places.get(image as usize).copied()
    }

    pub(crate) fn appearance(&self) -> &AppearanceGraph {
        &self.links
    }

    /// What a view and an image have in common; None if no motion joins them, or there is no such image.
    pub(crate) fn compare(&self, view: &PanoramicView, image: ImageId) -> Option<Overlap> {
        view.compare(self.views.get(image as usize)?, &SearchSettings::default()).overlap
    }

    /// The images that may show what a panorama does: all of a small map, else those that the index names.
    pub(crate) fn candidates(&self, shown: &Shown) -> Vec<ImageId> {
        if self.places.len() <= MAX_NAMED {
            return (0..self.places.len() as ImageId).collect();
        }
        self.index.most_voted(&shown.indexed, MAX_NAMED)
    }

    /// Convex spaces by image. It takes a while at first.
    pub(crate) fn spaces(&self) -> &[u32] {
        self.spaces.get_or_init(|| self.links.convex_spaces())
    }

    pub(super) fn links(&self) -> impl Iterator<Item = LinkView> + '_ {
        self.links.links().filter_map(|(from, link)| {
            let (from, to) = (self.place_of(from)?, self.place_of(link.to)?);
            Some(LinkView { from, to, similarity: link.similarity })
        })
    }

    /// Adds the panorama of a place that is above all others.
    fn add(&mut self, place: PlaceId, shown: Shown) -> Result<(), ArchiveError> {
        let coming = Coming { view: &shown.view, earlier: &self.views };
        let votes = self.index.votes(&shown.indexed);
        self.links.add(&coming, Checks::Promising(&votes))?;
        self.index.add(&shown.indexed);
        self.places.push(place);
        self.views.push(shown.view);
        self.spaces = OnceLock::new();
        Ok(())
    }

    fn memory_bytes(&self) -> u64 {
        let ray = size_of::<[f64; 3]>();
        let view = |view: &Arc<PanoramicView>| view.descriptors().as_bytes().len() + ray * view.rays().len();
        (self.views.iter().map(view).sum::<usize>() + self.index.memory_bytes()) as u64
    }
}

impl GrowingGraph {
    /// The graph with all places that the log has by now.
    pub(super) async fn up_to_date(self: &Arc<Self>, ground: Ground) -> Result<Arc<Graph>, ServiceError> {
        self.grow(ground).await?;
        let latest = self.latest.read().unwrap_or_else(PoisonError::into_inner).clone();
        latest.ok_or_else(|| ServiceError::internal("a graph that has grown is not there"))
    }

    /// The graph if it is to grow and nobody is about to let it.
    pub(super) fn wanted(self: &Arc<Self>) -> Option<Arc<Self>> {
        (!self.wanted.swap(true, Ordering::AcqRel)).then(|| self.clone())
    }

    /// Takes in what the log has by now, off the async threads and beside the map's writer.
    pub(super) async fn grow(self: &Arc<Self>, ground: Ground) -> Result<(), ServiceError> {
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
        let Growth { graph, next_place } = &mut *growth;
        let graph = graph.get_or_insert_with(|| Arc::new(Graph::empty()));
        loop {
            let places = ground.storage.first_frames(ground.map, *next_place, PIECE);
            let places = ground.runtime.block_on(places)?;
            if !places.is_empty() {
                // The others keep what they see.
                let growing = Arc::make_mut(graph);
                for &(place, frame) in &places {
                    if ground.stopping.is_cancelled() {
                        return Err(ServiceError::stopping());
                    }
                    if let Some(shown) = ground.panorama(frame)? {
                        growing.add(place, shown).map_err(FrameError::from)?;
                    }
                    *next_place = place + 1;
                }
            }
            self.memory_bytes.store(graph.memory_bytes(), Ordering::Relaxed);
            *self.latest.write().unwrap_or_else(PoisonError::into_inner) = Some(graph.clone());
            if places.len() < PIECE as usize {
                return Ok(());
            }
        }
    }
}

impl Ground {
    /// What a frame shows all around; none if its camera does not, or its features are not kept.
    fn panorama(&self, frame: FrameId) -> Result<Option<Shown>, ServiceError> {
        let stored = self.runtime.block_on(self.storage.features(self.map, frame))?;
        let Some(StoredFeatures { features, camera }) = stored else { return Ok(None) };
        let Some(optics) = camera.as_deref().and_then(PanoramicOptics::of_camera) else { return Ok(None) };
        let features = match FeatureRecord::from_bytes(&features) {
            Ok(features) => features,
            Err(error) => {
                tracing::error!(map = self.map, frame, %error, "a frame's features cannot be read; its place is no node");
                return Ok(None);
            }
        };
        Shown::new(&self.model, &optics, &features)
    }
}
