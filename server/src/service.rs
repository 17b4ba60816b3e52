//! What Waypost does for those who ask, whatever protocol they speak: gRPC and REST are thin
//! adapters over this.

pub(crate) mod appearance;
pub(crate) mod cluster;
pub(crate) mod correcting;
pub(crate) mod corrections;
mod deleted_maps;
pub(crate) mod events;
pub(crate) mod frames;
pub(crate) mod jobs;
pub(crate) mod labels;
mod map_names;
pub(crate) mod maps;
pub(crate) mod match_matrix;
mod measurements;
mod merge_request;
pub(crate) mod merges;
pub(crate) mod models;
pub(crate) mod navigation;
pub(crate) mod pictures;
pub(crate) mod queries;
mod read_map;
pub(crate) mod rebuilding;
pub(crate) mod refusals;
pub(crate) mod rewriting;
pub(crate) mod sessions;
mod shared;
pub(crate) mod snapshots;
mod streams;
mod taking_up;
pub(crate) mod tokens;
pub(crate) mod trajectories;

use std::sync::Arc;
use std::time::Duration;

use rustls::ClientConfig;
use tokio_util::sync::CancellationToken;

use self::appearance::AppearanceGraphs;
use self::cluster::Cluster;
use self::correcting::Correcting;
use self::deleted_maps::DeletedMaps;
use self::events::Events;
use self::frames::Frames;
use self::jobs::Jobs;
use self::labels::Labels;
use self::maps::Maps;
use self::match_matrix::MatchMatrices;
use self::measurements::Measurements;
use self::merges::Merges;
use self::models::Models;
use self::navigation::Navigation;
use self::pictures::Pictures;
use self::queries::Queries;
use self::rebuilding::Rebuilding;
use self::refusals::RefusalLog;
use self::rewriting::Rewriting;
use self::sessions::Sessions;
use self::shared::Shared;
use self::snapshots::Snapshots;
use self::tokens::Tokens;
use self::trajectories::Trajectories;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::ingest::extraction::Extraction;
use crate::metrics::{History, Levels, Metrics, QueueLengths};
use crate::net::neighbours::Neighbours;
use crate::open_map::OpenMaps;
use crate::quotas::ServerLimits;
use crate::storage::{Fleet, Moved, Source, Storage, StorageError, TakenOver};

/// How often it is seen to who looks at images, if nothing changes.
const LOOK_FOR_HELPERS: Duration = Duration::from_secs(5);

/// All that the server can do, by subject. Shared by every adapter.
#[derive(Debug)]
pub(crate) struct Service {
    pub(crate) appearance: AppearanceGraphs,
    pub(crate) cluster: Cluster,
    pub(crate) correcting: Correcting,
    pub(crate) events: Events,
    pub(crate) frames: Frames,
    pub(crate) history: History,
    pub(crate) jobs: Jobs,
    pub(crate) labels: Labels,
    pub(crate) maps: Maps,
    pub(crate) match_matrices: MatchMatrices,
    pub(crate) measurements: Measurements,
    pub(crate) merges: Merges,
    pub(crate) models: Models,
    pub(crate) navigation: Navigation,
    pub(crate) pictures: Pictures,
    pub(crate) queries: Queries,
    pub(crate) rebuilding: Rebuilding,
    pub(crate) refusals: RefusalLog,
    pub(crate) rewriting: Rewriting,
    pub(crate) sessions: Sessions,
    pub(crate) snapshots: Snapshots,
    pub(crate) tokens: Tokens,
    pub(crate) trajectories: Trajectories,
    pub(crate) neighbours: Neighbours,
    storage: Storage,
    open_maps: OpenMaps,
    extraction: Extraction,
    deleted_maps: DeletedMaps,
    metrics: Metrics,
    stopping: CancellationToken,
}

impl Service {
    pub(crate) fn new(storage: Storage, tokens: Tokens, metrics: Metrics) -> Self {
        let shared = Shared::new(storage, metrics);
        let frames = shared.frames();
        let models = shared.models();
        let maps = shared.maps(&models);
        let appearance = shared.appearance();
        let sessions = shared.sessions(&appearance);
        let labels = shared.labels(&maps, &appearance);
        let rewriting = shared.rewriting();
        let navigation = shared.navigation(&appearance, &labels);
        let cluster = shared.cluster(&navigation);
        let snapshots = shared.snapshots();
        let match_matrices = shared.match_matrices();
        let Shared { storage, open_maps, extraction, jobs, names, deleted_maps, .. } = shared;
        let Shared { metrics, refusals, stopping, .. } = shared;
        Self {
            merges: Merges::new(rewriting.clone(), names, deleted_maps.clone(), stopping.clone()),
            pictures: Pictures { storage: storage.clone(), frames: frames.clone() },
            queries: Queries::new(frames.clone(), extraction.clone()),
            events: Events::new(frames.clone(), navigation.clone(), stopping.clone()),
            correcting: Correcting { frames: frames.clone() },
            measurements: Measurements { frames: frames.clone() },
            trajectories: Trajectories { frames: frames.clone() },
            neighbours: Neighbours::of(storage.fleet().map(|fleet| fleet.secret).as_deref()),
            rebuilding: Rebuilding { maps: maps.clone(), sessions: sessions.clone(), jobs: jobs.clone() },
            appearance,
            cluster,
            frames,
            history: History::default(),
            jobs,
            labels,
            maps,
            match_matrices,
            models,
            navigation,
            refusals,
            rewriting,
            sessions,
            snapshots,
            tokens,
            storage,
            open_maps,
            extraction,
            deleted_maps,
            metrics,
            stopping,
        }
    }

    /// Begins what goes on in the background until the server stops: deleted maps lose their rows, and maps that nobody
    /// uses are closed while open ones take more than `map_memory_bytes`, and what was begun with tokens that expire ends.
    pub(crate) fn start_upkeep(&self, map_memory_bytes: u64) {
        self.jobs.track(self.deleted_maps.clone().keep_deleting());
        self.jobs.track(self.open_maps.clone().keep_within(map_memory_bytes));
        self.jobs.track(self.tokens.clone().keep_ending(self.stopping.clone()));
        self.jobs.track(self.storage.clone().keep_sweeping(self.stopping.clone()));
    }

    /// Has the other servers of the same database look at images, until this one stops.
    pub(crate) fn use_helpers(&self, tls: Option<Arc<ClientConfig>>) {
        let Some(Fleet { secret, mut helpers }) = self.storage.fleet() else { return };
        let (extraction, stopping) = (self.extraction.clone(), self.stopping.clone());
        self.jobs.track(async move {
            loop {
                let there = helpers.borrow_and_update().clone();
                extraction.set_helpers(&there, &secret, tls.as_ref());
                tokio::select! {
                    // One that was given up is tried again.
                    () = tokio::time::sleep(LOOK_FOR_HELPERS) => {}
                    changed = helpers.changed() => if changed.is_err() { return },
                    () = stopping.cancelled() => return,
                }
            }
        });
    }

    /// How much may be there from now on, whosever it is.
    pub(crate) fn set_limits(&self, limits: ServerLimits) {
        self.storage.quotas().set_server(limits);
    }

    /// Cancelled when the server begins to stop: streams end then.
    pub(crate) fn stopping(&self) -> &CancellationToken {
        &self.stopping
    }

    /// Sees to it that media go to the store where those of the database are.
    pub(crate) async fn settle_media_store(&self) -> Result<(), StorageError> {
        self.storage.settle_media_store().await
    }

    /// What an earlier server left unfinished when it went down is settled before anyone asks.
    pub(crate) async fn settle(&self) -> Result<(), ServiceError> {
        self.jobs.settle().await?;
        self.merges.settle().await?;
        Ok(self.storage.retire_imports().await?)
    }

    /// Ends streams and jobs, commits and checkpoints every map, closes the database.
    pub(crate) async fn stop(&self) {
        self.stopping.cancel();
        self.jobs.stop().await;
        self.open_maps.close_all().await;
        self.storage.close().await;
    }

    /// Brings over all that another database holds; see [`Storage::take_over_from`].
    pub(crate) async fn take_over_from(&self, source: Source) -> Result<Moved, StorageError> {
        self.storage.take_over_from(source).await
    }

    /// Asks the database for nothing more: it may be another server's.
    pub(crate) fn abandon(&self) {
        self.storage.abandon();
    }

    /// When another server owns the database.
    pub(crate) fn taken_over(&self) -> TakenOver {
        self.storage.taken_over()
    }

    /// Fails with the reason while requests are better sent elsewhere: the database does not answer, or
    /// the server is stopping.
    pub(crate) async fn ready(&self) -> Result<(), ServiceError> {
        if self.stopping.is_cancelled() {
            return Err(ServiceError::stopping());
        }
        self.storage.ping().await.map_err(|error| {
            tracing::error!(%error, "the database does not answer");
            ServiceError::unavailable("the database does not answer; the server's log says why")
        })
    }

    pub(crate) fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// Keeps what the metrics are now, for an hour.
    pub(crate) async fn keep_metrics(&self) {
        let rendered = self.rendered_metrics().await;
        self.history.keep(now_ns(), &rendered);
    }

    /// All metrics in Prometheus' text format.
    pub(crate) async fn rendered_metrics(&self) -> String {
        let open_maps = self.open_maps.count();
        let jobs_running = self.jobs.count();
        let (database_bytes, fleet) = tokio::join!(self.storage.size_bytes(), self.storage.fleet_levels());
        let database_bytes = database_bytes.ok();
        let disk_free_bytes = self.storage.free_bytes();
        let robots_led = self.navigation.counts();
        let extraction = self.extraction.backlog();
        let help = self.extraction.help();
        let queues = QueueLengths {
            images: extraction.on_hand,
            robots_in_line: extraction.in_line,
            maps: self.open_maps.waiting_requests(),
        };
        let (used, refusals) = self.storage.quotas().in_all();
        let process = crate::memory::process_levels();
        self.metrics.render(Levels {
            open_maps,
            jobs_running,
            database_bytes,
            disk_free_bytes,
            robots_led,
            queues,
            help,
            fleet,
            used,
            refusals,
            process,
        })
    }
}
