//! What the subjects share, and how each is made of it.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::appearance::AppearanceGraphs;
use super::cluster::Cluster;
use super::deleted_maps::DeletedMaps;
use super::frames::Frames;
use super::jobs::Jobs;
use super::labels::Labels;
use super::map_names::MapNames;
use super::maps::Maps;
use super::match_matrix::MatchMatrices;
use super::models::Models;
use super::navigation::{Navigation, Registry};
use super::refusals::RefusalLog;
use super::rewriting::Rewriting;
use super::sessions::{Sessions, Turns};
use super::snapshots::Snapshots;
use super::streams::Streams;
use crate::ingest::extraction::Extraction;
use crate::ingest::model::LoadedModels;
use crate::metrics::Metrics;
use crate::open_map::OpenMaps;
use crate::storage::{Storage, cores};

/// Each is cheap to clone, and all clones are one.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) storage: Storage,
    pub(super) loaded: LoadedModels,
    pub(super) open_maps: OpenMaps,
    pub(super) extraction: Extraction,
    pub(super) jobs: Jobs,
    pub(super) names: MapNames,
    pub(super) deleted_maps: DeletedMaps,
    pub(super) streams: Streams,
    pub(super) led: Arc<Registry>,
    pub(super) metrics: Metrics,
    pub(super) refusals: RefusalLog,
    pub(super) stopping: CancellationToken,
}

impl Shared {
    pub(super) fn new(storage: Storage, metrics: Metrics) -> Self {
        let stopping = CancellationToken::new();
        let loaded = LoadedModels::new(storage.clone());
        let deleted_maps = DeletedMaps::new(storage.clone(), stopping.clone());
        Self {
            open_maps: OpenMaps::new(storage.clone(), loaded.clone(), metrics.clone(), stopping.clone()),
            extraction: Extraction::new(cores()),
            jobs: Jobs::new(storage.clone(), deleted_maps.clone(), stopping.clone()),
            names: MapNames::new(storage.clone()),
            streams: Streams::new(),
            refusals: RefusalLog::default(),
            led: Arc::default(),
            storage,
            loaded,
            deleted_maps,
            metrics,
            stopping,
        }
    }

    pub(super) fn frames(&self) -> Frames {
        let Self { storage, loaded: models, open_maps, .. } = self.clone();
        Frames { storage, models, open_maps }
    }

    pub(super) fn models(&self) -> Models {
        let Self { storage, loaded, extraction, jobs, .. } = self.clone();
        Models::new(storage, loaded, extraction, jobs)
    }

    pub(super) fn maps(&self, models: &Models) -> Maps {
        let Self { storage, loaded, open_maps, names, .. } = self.clone();
        Maps { storage, models: models.clone(), loaded, open_maps, names }
    }

    pub(super) fn match_matrices(&self) -> MatchMatrices {
        let Self { storage, loaded, open_maps, .. } = self.clone();
        MatchMatrices::new(storage, loaded, open_maps)
    }

    pub(super) fn appearance(&self) -> AppearanceGraphs {
        let Self { storage, loaded: models, open_maps, jobs, stopping, .. } = self.clone();
        AppearanceGraphs { storage, models, open_maps, jobs, stopping }
    }

    pub(super) fn sessions(&self, graphs: &AppearanceGraphs) -> Sessions {
        let Self { storage, loaded: models, open_maps, extraction, streams, .. } = self.clone();
        let Self { metrics, refusals, stopping, .. } = self.clone();
        let graphs = graphs.clone();
        let turns = Turns::default();
        Sessions {
            storage,
            models,
            open_maps,
            extraction,
            graphs,
            streams,
            metrics,
            refusals,
            turns,
            stopping,
        }
    }

    pub(super) fn labels(&self, maps: &Maps, graphs: &AppearanceGraphs) -> Labels {
        Labels { storage: self.storage.clone(), maps: maps.clone(), graphs: graphs.clone() }
    }

    pub(super) fn rewriting(&self) -> Rewriting {
        let Self { storage, loaded: models, open_maps, jobs, led, deleted_maps, .. } = self.clone();
        Rewriting { storage, models, open_maps, jobs, led, deleted_maps }
    }

    pub(super) fn navigation(&self, graphs: &AppearanceGraphs, labels: &Labels) -> Navigation {
        let Self { storage, loaded: models, open_maps, extraction, streams, .. } = self.clone();
        let Self { led, refusals, stopping, .. } = self.clone();
        let graphs = graphs.clone();
        let labels = labels.clone();
        let quotas = storage.quotas().clone();
        Navigation { models, open_maps, extraction, graphs, labels, streams, led, refusals, quotas, stopping }
    }

    pub(super) fn cluster(&self, navigation: &Navigation) -> Cluster {
        let Self { storage, open_maps, extraction, streams, jobs, .. } = self.clone();
        Cluster { storage, open_maps, extraction, streams, navigation: navigation.clone(), jobs }
    }

    pub(super) fn snapshots(&self) -> Snapshots {
        let Self { storage, jobs, names, deleted_maps, stopping, .. } = self.clone();
        Snapshots::new(storage, jobs, names, deleted_maps, stopping)
    }
}
