//! Models, maps and logs in one SQLite file, or in a database of PostgreSQL. All SQL of the project is in this module.
//!
//! Both databases get the same statements, through `sqlx::Any`; what only one of them knows is in `engine`.

mod appearance;
mod appending;
mod batches;
mod cameras;
mod checkpoints;
mod columns;
mod commits;
mod connections;
mod corrections;
mod damage;
mod engine;
mod error;
mod frames;
mod jobs;
mod kept;
mod labels;
mod log;
mod maps;
mod media;
mod media_address;
mod media_store;
mod merges;
mod models;
mod moving;
mod new_events;
mod notes;
mod objects;
mod postgres;
mod removal;
mod retelling;
mod row_sums;
mod salvage;
mod snapshots;
mod sqlite;
mod tokens;
mod values;

pub(crate) use appearance::{KeptLinks, LinkRow};
pub(crate) use checkpoints::{CheckpointView, StoredBlock};
pub(crate) use columns::reason_name;
pub(crate) use engine::TakenOver;
pub(crate) use error::StorageError;
pub(crate) use frames::{FrameBytes, FrameRow, SessionSummary};
pub(crate) use jobs::{JobEnd, JobKind, JobRow, NewJob, StoredError, StoredJobState};
pub(crate) use labels::LabelRow;
pub(crate) use log::{ClosureRow, LogEntry, StoredFrame};
pub(crate) use maps::{MapCounts, MapEdition, MapId, MapRow, SessionRow};
pub(crate) use media::{MapBytes, Medium, MediumKind, StoredFeatures, kept_bytes};
pub use media_address::{MediaAddress, NoMediaAddress};
pub(crate) use media_store::{check_media_beside_sqlite, inspect_media_store};
pub(crate) use merges::{JoinedLog, JoinedSession, MergeOutcome, MergeRow, MergeState};
pub(crate) use models::ModelRow;
pub(crate) use moving::{Moved, Source};
pub(crate) use notes::NoteRow;
pub(crate) use postgres::{
    Addresses, Claim, ClusterRows, Fleet, FleetLevels, HelperRow, Owner, ServerRow, StandbyRow, VERSION,
    WhileOwned, cores, holder, host_name, inspect_postgres, model_file, parse_postgres_address,
};
pub(crate) use removal::Removal;
pub(crate) use retelling::RetoldLog;
pub(crate) use salvage::Salvaged;
pub(crate) use snapshots::{FormerModelRow, ImportedMap, MapView, MediaRow, StoredSession};
pub(crate) use sqlite::{DeepInspection, Inspection, back_up, file_system, inspect, inspect_all, restore};
pub(crate) use tokens::{FormerSecret, SecretHash, TokenRow};

use damage::Damages;
use engine::Engine;
use objects::Objects;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use sqlx::pool::PoolConnection;
use sqlx::{Any, AnyConnection, AnyPool, AssertSqlSafe, Connection, Transaction};

use crate::quotas::Quotas;

/// The database of one server. Cheap to clone.
///
/// There is one connection that writes, and a few that read: readers see a consistent snapshot and never wait for the
/// writer.
#[derive(Clone, Debug)]
pub(crate) struct Storage {
    writer: AnyPool,
    readers: AnyPool,
    /// Those that hold a snapshot for long are kept apart: they must not use up the readers.
    exporters: AnyPool,
    directory: PathBuf,
    engine: Engine,
    damages: Arc<Damages>,
    /// Events that are to be appended.
    waiting: Arc<appending::Waiting>,
    /// Whoever watches maps.
    commits: Arc<commits::Commits>,
    quotas: Quotas,
    /// Where media lie that are not in the database.
    objects: Option<Arc<Objects>>,
}

/// Connections to a database.
struct Pools {
    writer: AnyPool,
    readers: AnyPool,
    exporters: AnyPool,
}

const READERS: u32 = 4;
/// Snapshots that may be read out at the same time.
pub(crate) const EXPORTERS: u32 = 2;

impl Storage {
    /// Opens the SQLite database of `directory`, making both where they are missing.
    pub(crate) async fn open(directory: &Path) -> Result<Self, StorageError> {
        let (engine, pools) = sqlite::open(directory).await?;
        Self::over(Engine::Sqlite(engine), pools, directory, None).await
    }

    /// The same where media may be wanted elsewhere, which is refused.
    pub(crate) async fn open_with(directory: &Path, media: &MediaAddress) -> Result<Self, StorageError> {
        check_media_beside_sqlite(media)?;
        Self::open(directory).await
    }

    /// Opens a database of PostgreSQL, making its tables where they are missing. In
    /// `directory`, which is made, lie files for a while.
    pub(crate) async fn connect(
        address: &str,
        directory: &Path,
        media: &MediaAddress,
        claim: Claim,
    ) -> Result<Self, StorageError> {
        let objects = Objects::at(media)?;
        sqlite::make_directory(directory).map_err(|source| StorageError::of_directory(directory, source))?;
        let (engine, pools) = postgres::open(address, claim).await?;
        Self::over(Engine::Postgres(engine), pools, directory, objects).await
    }

    async fn over(
        engine: Engine,
        pools: Pools,
        directory: &Path,
        objects: Option<Objects>,
    ) -> Result<Self, StorageError> {
        let Pools { writer, readers, exporters } = pools;
        let storage = Self {
            writer,
            readers,
            exporters,
            directory: directory.to_owned(),
            engine,
            damages: Arc::default(),
            waiting: Arc::default(),
            commits: Arc::default(),
            quotas: Quotas::default(),
            objects: objects.map(Arc::new),
        };
        storage.load_damages().await?;
        if let Engine::Sqlite(_) = storage.engine {
            storage.mend_old_rows().await?;
        }
        storage.count_used().await?;
        Ok(storage)
    }

    /// Brings up to date what earlier servers stored, where SQL cannot.
    async fn mend_old_rows(&self) -> Result<(), StorageError> {
        self.rewrite_camera_messages().await?;
        self.sum_old_rows().await?;
        self.count_old_sessions().await
    }

    /// Where files may lie for a while; and the database, where it is one of SQLite.
    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }

    /// One transaction: all of `work`, or nothing.
    ///
    /// After a failure the connection is closed: a commit that fails, on a full disk for example, can
    /// leave its transaction open, and the next one would be nested in it and never reach the disk.
    async fn write<T>(
        &self,
        work: impl AsyncFnOnce(&mut Transaction<'_, Any>) -> Result<T, StorageError>,
    ) -> Result<T, StorageError> {
        self.write_and(work, async |_, _| {}).await
    }

    /// The same, and something after it that no other transaction comes before.
    async fn write_and<T>(
        &self,
        work: impl AsyncFnOnce(&mut Transaction<'_, Any>) -> Result<T, StorageError>,
        after: impl AsyncFnOnce(&mut AnyConnection, &T),
    ) -> Result<T, StorageError> {
        let mut connection = self.writing_connection().await?;
        let written = async {
            let mut transaction = connection.begin().await?;
            self.engine.fence(&mut transaction).await?;
            let value = work(&mut transaction).await?;
            transaction.commit().await?;
            Ok(value)
        }
        .await;
        if let Ok(value) = &written {
            after(&mut connection, value).await;
        }
        if written.is_err() {
            connection.close_on_drop();
        }
        written
    }

    /// The one connection that writes, once it is free.
    async fn writing_connection(&self) -> Result<PoolConnection<Any>, StorageError> {
        loop {
            match self.writer.acquire().await {
                Err(sqlx::Error::PoolTimedOut) if self.engine.is_compacting() => {}
                acquired => return Ok(acquired?),
            }
        }
    }

    /// Nothing more is asked of the database, which may be another server's by now; what waits for a connection fails.
    pub(crate) fn abandon(&self) {
        for pool in [&self.readers, &self.exporters, &self.writer] {
            // It is closed by now. The rest would wait for connections that are in use.
            drop(pool.close());
        }
    }

    /// Waits for what is being written; folds SQLite's write-ahead log into the file, and leaves PostgreSQL to the next
    /// server.
    pub(crate) async fn close(&self) {
        self.readers.close().await;
        self.exporters.close().await;
        self.engine.hand_over(&self.writer).await;
        self.writer.close().await;
        // A connection that is still being closed may hold a copy of this for a moment more.
        self.engine.release();
    }
}

/// Deletes the first rows of a map in a table, by its key, as many as are deleted at a time; how many there were.
async fn delete_some(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    (table, key, rows): (&str, &str, u32),
) -> Result<u64, StorageError> {
    let delete = format!(
        "DELETE FROM {table} WHERE map_id = $1 AND {key} IN \
         (SELECT {key} FROM {table} WHERE map_id = $1 ORDER BY {key} LIMIT $2)"
    );
    let done = sqlx::query(AssertSqlSafe(delete))
        .bind(map)
        .bind(i64::from(rows))
        .execute(&mut **transaction)
        .await?;
    Ok(done.rows_affected())
}
