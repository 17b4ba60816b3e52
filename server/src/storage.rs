//! Models, maps and logs in one SQLite file. All SQL of the project is in this module.

mod appearance;
mod backups;
mod cameras;
mod checkpoints;
mod columns;
mod commits;
mod corrections;
mod damage;
mod deep_inspection;
mod frames;
mod inspection;
mod jobs;
mod kept;
mod labels;
mod lock;
mod log;
mod maps;
mod media;
mod merges;
mod models;
mod notes;
mod opening;
mod page_sums;
mod removal;
mod retelling;
mod row_sums;
mod salvage;
mod snapshots;
mod tokens;

pub(crate) use appearance::{KeptLinks, LinkRow};
pub(crate) use backups::{back_up, restore};
pub(crate) use checkpoints::{CheckpointView, StoredBlock};
pub(crate) use columns::reason_name;
pub(crate) use deep_inspection::{DeepInspection, inspect_all};
pub(crate) use frames::{FrameBytes, FrameRow, SessionSummary};
pub(crate) use inspection::{Inspection, inspect};
pub(crate) use jobs::{JobEnd, JobKind, JobRow, StoredError, StoredJobState};
pub(crate) use labels::LabelRow;
pub(crate) use log::{ClosureRow, LogEntry, StoredFrame};
pub(crate) use maps::{MapCounts, MapEdition, MapId, MapRow, SessionRow};
pub(crate) use media::{MapBytes, Medium, MediumKind, StoredFeatures, kept_bytes};
pub(crate) use merges::{JoinedLog, JoinedSession, MergeOutcome, MergeRow, MergeState};
pub(crate) use models::ModelRow;
pub(crate) use notes::NoteRow;
pub(crate) use removal::Removal;
pub(crate) use retelling::RetoldLog;
pub(crate) use salvage::Salvaged;
pub(crate) use snapshots::{FormerModelRow, ImportedMap, MapView, MediaRow, StoredSession};
pub(crate) use tokens::{FormerSecret, SecretHash, TokenRow};

use damage::Damages;
use lock::DirectoryLock;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use sqlx::migrate::MigrateError;
use sqlx::pool::PoolConnection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{AssertSqlSafe, Connection, Sqlite, SqliteConnection, SqlitePool, Transaction};

use crate::quotas::{OverQuota, Quotas};

/// The database of one data directory. Cheap to clone.
///
/// There is one connection that writes, and a few that read: in WAL mode readers see a consistent
/// snapshot and never wait for the writer.
#[derive(Clone, Debug)]
pub(crate) struct Storage {
    writer: SqlitePool,
    readers: SqlitePool,
    /// Those that hold a snapshot for long are kept apart: they must not use up the readers.
    exporters: SqlitePool,
    directory: PathBuf,
    /// Held until the storage is closed; two servers on one directory would each believe that they are
    /// the one writer.
    lock: Arc<DirectoryLock>,
    /// Writers wait while the database is rewritten, however long that takes.
    compacting: Arc<AtomicBool>,
    damages: Arc<Damages>,
    /// Whoever watches maps.
    commits: Arc<commits::Commits>,
    quotas: Quotas,
}

/// What went wrong with the database.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StorageError {
    #[error(
        "cannot use the data directory {directory}: {source}; give a directory that this user may write to"
    )]
    Directory { directory: PathBuf, source: std::io::Error },
    #[error(
        "the data directory {directory} is used by another waypost-server; stop that one, or give another directory"
    )]
    Locked { directory: PathBuf },
    #[error(
        "the database was written by a newer Waypost (schema {schema}); update this server, or give another data directory"
    )]
    Newer { schema: i64 },
    #[error("{path} is no database of Waypost; restore it from a copy, or give another data directory")]
    NoDatabase { path: PathBuf },
    #[error("{path} is damaged ({reason}); restore it from a backup, or give another data directory")]
    Broken { path: PathBuf, reason: String },
    #[error("the disk is full; free some space")]
    DiskFull(#[source] sqlx::Error),
    #[error("the database is held up: {0}")]
    HeldUp(sqlx::Error),
    #[error("something of this name is there already")]
    Exists,
    #[error("it is still in use")]
    InUse,
    #[error("the job has ended already")]
    JobEnded,
    #[error("the log was rewritten, or deleted, since it was read")]
    Retold,
    #[error("the database holds what cannot be read: {0}; restore it from a copy")]
    Damaged(String),
    #[error("{0}")]
    Rot(String),
    #[error(
        "the map takes nothing more since damage was found in it: {0}; `waypost-server check --deep` tells all of it; \
         `waypost map repair` makes a new map of what is left, and of a snapshot"
    )]
    ReadOnly(String),
    #[error("{0}")]
    OverQuota(#[from] OverQuota),
    #[error("the database failed: {0}")]
    Sqlite(sqlx::Error),
    #[error(
        "the database could not be brought up to date: {0}; use the version that wrote it, or restore it from a backup"
    )]
    Migration(MigrateError),
}

const FILE_NAME: &str = "waypost.sqlite";
const READERS: u32 = 4;
/// Snapshots that may be read out at the same time.
pub(crate) const EXPORTERS: u32 = 2;
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
const WAL_LIMIT_BYTES: &str = "4194304";

impl Storage {
    /// Opens the database of `directory`, making both where they are missing.
    pub(crate) async fn open(directory: &Path) -> Result<Self, StorageError> {
        let lock = DirectoryLock::take(directory)?;
        opening::prepare(directory).await?;
        let options = SqliteConnectOptions::new()
            .filename(directory.join(FILE_NAME))
            .vfs(page_sums::VFS)
            .journal_mode(SqliteJournalMode::Wal)
            // An acknowledged frame must survive a power cut, not the process alone.
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIMEOUT)
            // The write-ahead log shrinks to this once nobody reads from it any more.
            .pragma("journal_size_limit", WAL_LIMIT_BYTES);
        let writer = SqlitePoolOptions::new().max_connections(1).connect_with(options.clone()).await;
        let writer = writer.map_err(|error| or_no_database(error, directory))?;
        sqlx::migrate!("../migrations").run(&writer).await.map_err(|error| match error {
            MigrateError::VersionMissing(schema) => StorageError::Newer { schema },
            MigrateError::Execute(error) => or_no_database(error, directory),
            other => StorageError::Migration(other),
        })?;
        let options = options.read_only(true);
        let readers = SqlitePoolOptions::new().max_connections(READERS).connect_with(options.clone()).await?;
        let exporters = SqlitePoolOptions::new().max_connections(EXPORTERS).connect_lazy_with(options);
        let (directory, lock) = (directory.to_owned(), Arc::new(lock));
        let storage = Self {
            writer,
            readers,
            exporters,
            directory,
            lock,
            compacting: Arc::default(),
            damages: Arc::default(),
            commits: Arc::default(),
            quotas: Quotas::default(),
        };
        storage.rewrite_camera_messages().await?;
        storage.sum_old_rows().await?;
        storage.load_damages().await?;
        storage.count_old_sessions().await?;
        storage.count_used().await?;
        Ok(storage)
    }

    /// Where the database lies.
    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }

    /// One transaction: all of `work`, or nothing.
    ///
    /// After a failure the connection is closed: a commit that fails, on a full disk for example, can
    /// leave its transaction open, and the next one would be nested in it and never reach the disk.
    async fn write<T>(
        &self,
        work: impl AsyncFnOnce(&mut Transaction<'_, Sqlite>) -> Result<T, StorageError>,
    ) -> Result<T, StorageError> {
        self.write_and(work, async |_, _| {}).await
    }

    /// The same, and something after it that no other transaction comes before.
    async fn write_and<T>(
        &self,
        work: impl AsyncFnOnce(&mut Transaction<'_, Sqlite>) -> Result<T, StorageError>,
        after: impl AsyncFnOnce(&mut SqliteConnection, &T),
    ) -> Result<T, StorageError> {
        let mut connection = self.writing_connection().await?;
        let written = async {
            let mut transaction = connection.begin().await?;
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
    async fn writing_connection(&self) -> Result<PoolConnection<Sqlite>, StorageError> {
        loop {
            match self.writer.acquire().await {
                Err(sqlx::Error::PoolTimedOut) if self.compacting.load(Ordering::Relaxed) => {}
                acquired => return Ok(acquired?),
            }
        }
    }

    /// Waits for what is being written and folds the write-ahead log into the file.
    pub(crate) async fn close(&self) {
        self.readers.close().await;
        self.exporters.close().await;
        self.writer.close().await;
        // A connection that is still being closed may hold a copy of this for a moment more.
        self.lock.release();
    }
}

/// Who writes the checksums, as SQLite knows it.
pub(crate) fn file_system() -> Result<&'static str, StorageError> {
    page_sums::register()?;
    Ok(page_sums::VFS)
}

/// SQLite's primary result codes.
const SQLITE_BUSY: u32 = 5;
const SQLITE_LOCKED: u32 = 6;
const SQLITE_IOERR: u32 = 10;
const SQLITE_CORRUPT: u32 = 11;
const SQLITE_FULL: u32 = 13;
const SQLITE_CANTOPEN: u32 = 14;
const SQLITE_NOTADB: u32 = 26;

/// The primary result code of SQLite, if it was SQLite that failed.
fn primary_code(error: &sqlx::Error) -> Option<u32> {
    let extended: u32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(extended & 0xff)
}

/// The whole result code of SQLite where a page is not as it was written.
const SQLITE_IOERR_DATA: &str = "8202";

/// Whether SQLite met what is not as it was written.
fn is_rot(error: &sqlx::Error) -> bool {
    let checksum = error
        .as_database_error()
        .and_then(sqlx::error::DatabaseError::code)
        .is_some_and(|code| code == SQLITE_IOERR_DATA);
    checksum || primary_code(error) == Some(SQLITE_CORRUPT)
}

fn or_no_database(error: sqlx::Error, directory: &Path) -> StorageError {
    let path = || directory.join(FILE_NAME);
    if is_rot(&error) {
        let reason =
            "a part of it is not as it was written; `waypost-server check --deep` tells which".to_owned();
        return StorageError::Broken { path: path(), reason };
    }
    match primary_code(&error) {
        Some(SQLITE_NOTADB) => StorageError::NoDatabase { path: path() },
        Some(_) | None => error.into(),
    }
}

impl From<sqlx::Error> for StorageError {
    fn from(error: sqlx::Error) -> Self {
        if let sqlx::Error::ColumnDecode { .. } = &error {
            return Self::Damaged(error.to_string());
        }
        if let sqlx::Error::PoolTimedOut = &error {
            return Self::HeldUp(error);
        }
        if let Some(database) = error.as_database_error() {
            if database.is_unique_violation() {
                return Self::Exists;
            }
            if database.is_foreign_key_violation() {
                return Self::InUse;
            }
        }
        if is_rot(&error) {
            return Self::Rot("a part of the database is damaged on the disk".to_owned());
        }
        match primary_code(&error) {
            Some(SQLITE_FULL) => Self::DiskFull(error),
            Some(SQLITE_BUSY | SQLITE_LOCKED | SQLITE_IOERR | SQLITE_CANTOPEN) => Self::HeldUp(error),
            Some(_) | None => Self::Sqlite(error),
        }
    }
}

/// Deletes the first rows of a map in a table, by its key, as many as are deleted at a time; how many there were.
async fn delete_some(
    transaction: &mut Transaction<'_, Sqlite>,
    map: MapId,
    (table, key, rows): (&str, &str, u32),
) -> Result<u64, StorageError> {
    let delete = format!(
        "DELETE FROM {table} WHERE map_id = ?1 AND {key} IN \
         (SELECT {key} FROM {table} WHERE map_id = ?1 ORDER BY {key} LIMIT ?2)"
    );
    let done = sqlx::query(AssertSqlSafe(delete)).bind(map).bind(rows).execute(&mut **transaction).await?;
    Ok(done.rows_affected())
}

/// SQLite's integers are signed; ours are counts and never reach 2^63.
fn to_sql(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

fn from_sql(count: i64) -> Result<u64, StorageError> {
    u64::try_from(count).map_err(|_| StorageError::Damaged(format!("the count {count}")))
}
