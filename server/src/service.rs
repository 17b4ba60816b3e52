//! What Waypost does for those who ask, whatever protocol they speak: gRPC and REST are thin
//! adapters over this.

pub(crate) mod appearance;
pub(crate) mod camera;
pub(crate) mod content;
pub(crate) mod frames;
pub(crate) mod jobs;
pub(crate) mod map_settings;
mod map_writer;
pub(crate) mod maps;
mod measurements;
pub(crate) mod merges;
pub(crate) mod models;
pub(crate) mod names;
pub(crate) mod navigations;
pub(crate) mod pictures;
pub(crate) mod queries;
mod rebuilding;
mod removal;
pub(crate) mod sessions;
pub(crate) mod snapshots;
pub(crate) mod tokens;
pub(crate) mod trajectories;

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use crate::error::ServiceError;
use crate::extraction::{Extraction, LoadedModel};
use crate::metrics::{Levels, Metrics};
use crate::service::jobs::Jobs;
use crate::service::map_writer::OpenMaps;
use crate::service::merges::Merges;
use crate::service::navigations::Navigations;
use crate::service::removal::Removals;
use crate::service::snapshots::Snapshots;
use crate::service::tokens::Tokens;
use crate::storage::Storage;

/// All that the server can do. Shared by every adapter.
#[derive(Debug)]
pub(crate) struct Service {
    storage: Storage,
    tokens: Tokens,
    metrics: Metrics,
    extraction: Extraction,
    /// Models in use, by hash; they are immutable.
    models: Mutex<HashMap<String, Arc<LoadedModel>>>,
    open_maps: OpenMaps,
    navigations: Navigations,
    jobs: Jobs,
    merges: Merges,
    snapshots: Snapshots,
    removals: Removals,
    uploads: Arc<Semaphore>,
    /// Room for streams.
    streams: Arc<Semaphore>,
    /// Replays of a map for an explanation.
    replays: Arc<Semaphore>,
    /// Numbers streams, so that a later one on the same session is known from an earlier.
    next_stream: AtomicU64,
    stopping: CancellationToken,
}

impl Service {
    pub(crate) fn new(storage: Storage, tokens: Tokens, metrics: Metrics) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            storage,
            tokens,
            metrics,
            extraction: Extraction::new(cores),
            models: Mutex::default(),
            open_maps: OpenMaps::default(),
            navigations: Navigations::default(),
            jobs: Jobs::default(),
            merges: Merges::default(),
            snapshots: Snapshots::default(),
            removals: Removals::default(),
            uploads: Arc::new(Semaphore::new(models::MAX_UPLOADS)),
            streams: Arc::new(Semaphore::new(sessions::MAX_STREAMS)),
            replays: Arc::new(Semaphore::new(1)),
            next_stream: AtomicU64::new(0),
            stopping: CancellationToken::new(),
        }
    }

    /// Cancelled when the server begins to stop: streams end then.
    pub(crate) fn stopping(&self) -> &CancellationToken {
        &self.stopping
    }

    /// What an earlier server left unfinished when it went down is settled before anyone asks.
    pub(crate) async fn settle(&self) -> Result<(), ServiceError> {
        self.settle_jobs().await?;
        self.settle_merges().await?;
        Ok(self.storage.retire_imports().await?)
    }

    /// Ends streams and jobs, commits and checkpoints every map, closes the database.
    pub(crate) async fn stop(&self) {
        self.stopping.cancel();
        self.stop_jobs().await;
        self.open_maps.close_all().await;
        self.storage.close().await;
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

    pub(crate) fn tokens(&self) -> &Tokens {
        &self.tokens
    }

    pub(crate) fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// All metrics in Prometheus' text format.
    pub(crate) async fn rendered_metrics(&self) -> String {
        let (open_maps, jobs_running) = (self.open_maps.count(), self.jobs.count());
        let database_bytes = self.storage.size_bytes().await.ok();
        self.metrics.render(Levels { open_maps, jobs_running, database_bytes })
    }

    fn new_stream(&self) -> u64 {
        self.next_stream.fetch_add(1, Ordering::Relaxed)
    }

    /// A model ready for work, read from the database if need be.
    async fn loaded_model(&self, hash: &str) -> Result<Arc<LoadedModel>, ServiceError> {
        if let Some(model) = self.cached_models().get(hash) {
            return Ok(model.clone());
        }
        let file = self.storage.model_file(hash).await?;
        let file = file.ok_or_else(|| ServiceError::not_found(format_args!("there is no model {hash}")))?;
        let load = move || {
            let model = fabmap::model::Model::from_bytes(&file).map_err(ServiceError::internal)?;
            LoadedModel::new(model)
        };
        let loaded = tokio::task::spawn_blocking(load).await.map_err(ServiceError::internal)??;
        let loaded = Arc::new(loaded);
        self.cached_models().insert(hash.to_owned(), loaded.clone());
        Ok(loaded)
    }

    fn cached_models(&self) -> std::sync::MutexGuard<'_, HashMap<String, Arc<LoadedModel>>> {
        self.models.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Now, in nanoseconds since 1970.
fn now_ns() -> i64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX)
}
