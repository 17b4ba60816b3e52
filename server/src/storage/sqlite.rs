//! The database as one file of SQLite in the data directory: how it is opened, copied and looked at from outside.

mod backups;
mod deep_inspection;
mod inspection;
mod lock;
mod opening;
mod page_sums;

pub(crate) use backups::{back_up, restore};
pub(crate) use deep_inspection::{DeepInspection, inspect_all};
pub(crate) use inspection::{Inspection, inspect};

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

pub(super) use lock::make_directory;

use lock::DirectoryLock;
use opening::FileKind;
use sqlx::any::AnyPoolOptions;
use sqlx::migrate::MigrateError;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{Any, AnyConnection, AnyPool, ConnectOptions, Connection, Transaction};

use super::error::{SQLITE_NOTADB, is_rot, primary_code};
use super::{EXPORTERS, Pools, READERS, StorageError, connections};

const FILE_NAME: &str = "waypost.sqlite";
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
const WAL_LIMIT_BYTES: u32 = 4_194_304;

/// A data directory with its database.
#[derive(Clone, Debug)]
pub(super) struct Sqlite {
    /// Held until the storage is closed; two servers on one directory would each believe that they are
    /// the one writer.
    lock: Arc<DirectoryLock>,
    /// Writers wait while the database is rewritten, however long that takes.
    compacting: Arc<AtomicBool>,
}

/// What may be done over a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Access {
    Write,
    Read,
}

/// Opens the database of `directory`, making both where they are missing.
pub(super) async fn open(directory: &Path) -> Result<(Sqlite, Pools), StorageError> {
    let lock = DirectoryLock::take(directory)?;
    opening::prepare(directory).await?;
    migrate(directory).await?;
    let file = std::path::absolute(directory.join(FILE_NAME))
        .map_err(|source| StorageError::of_directory(directory, source))?;
    let writer = pool(1, Access::Write).connect(&address(&file, Access::Write)).await;
    let writer = writer.map_err(|error| or_no_database(error, directory))?;
    let read = address(&file, Access::Read);
    let readers = pool(READERS, Access::Read).connect(&read).await?;
    let exporters = pool(EXPORTERS, Access::Read).connect_lazy(&read)?;
    let engine = Sqlite { lock: Arc::new(lock), compacting: Arc::default() };
    Ok((engine, Pools { writer, readers, exporters }))
}

/// Brings the tables up to date.
async fn migrate(directory: &Path) -> Result<(), StorageError> {
    let options = SqliteConnectOptions::new()
        .filename(directory.join(FILE_NAME))
        .vfs(page_sums::VFS)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT);
    let mut connection = options.connect().await.map_err(|error| or_no_database(error, directory))?;
    let migrated = sqlx::migrate!("../migrations").run(&mut connection).await;
    migrated.map_err(|error| match error {
        MigrateError::VersionMissing(schema) => StorageError::Newer { schema },
        MigrateError::Execute(error) => or_no_database(error, directory),
        other => StorageError::Migration(other),
    })?;
    Ok(connection.close().await?)
}

fn pool(connections: u32, access: Access) -> AnyPoolOptions {
    connections::pool(connections).after_connect(move |connection, _| {
        Box::pin(async move {
            let timeout_ms = BUSY_TIMEOUT.as_millis();
            let mut settings = format!("PRAGMA busy_timeout = {timeout_ms}; PRAGMA foreign_keys = ON;");
            if access == Access::Write {
                settings.push_str("PRAGMA journal_mode = WAL;");
            }
            // An acknowledged frame must survive a power cut, not the process alone. The write-ahead log shrinks to its
            // limit once nobody reads from it any more.
            settings.push_str(&format!(
                "PRAGMA synchronous = FULL; PRAGMA journal_size_limit = {WAL_LIMIT_BYTES};"
            ));
            sqlx::raw_sql(sqlx::AssertSqlSafe(settings)).execute(connection).await?;
            Ok(())
        })
    })
}

/// The file as sqlx addresses it, with who writes its checksums.
fn address(file: &Path, access: Access) -> String {
    let mode = match access {
        Access::Write => "rw",
        Access::Read => "ro",
    };
    format!("sqlite://{}?mode={mode}&vfs={}", opening::percent_encoded(file), page_sums::VFS)
}

impl Sqlite {
    /// Whether writers are to wait for longer than they would.
    pub(super) fn is_compacting(&self) -> bool {
        self.compacting.load(Ordering::Relaxed)
    }

    /// Rewrites the file without what was deleted, which is still between the rows until then, and in the write-ahead
    /// log. Commits wait meanwhile. [`StorageError::InUse`] if somebody reads from that log for so long that it cannot
    /// be emptied.
    pub(super) async fn wipe_deleted(&self, writer: &AnyPool) -> Result<(), StorageError> {
        let _compacting = Compacting::begin(&self.compacting);
        sqlx::query("VACUUM").execute(writer).await?;
        // The first column says whether it could not.
        let busy: i64 = sqlx::query_scalar("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(writer).await?;
        if busy == 0 { Ok(()) } else { Err(StorageError::InUse) }
    }

    /// Once nothing of it is open any more.
    pub(super) fn release(&self) {
        self.lock.release();
    }
}

/// Size of the database, without what is still in the write-ahead log.
pub(super) const SIZE_BYTES: &str =
    "SELECT pages.page_count * sizes.page_size FROM pragma_page_count AS pages, pragma_page_size AS sizes";

/// The last number that a table gave.
pub(super) const LAST_NUMBER: &str = "SELECT seq FROM sqlite_sequence WHERE name = $1";

/// The next number that a table gives is above `last`.
pub(super) async fn give_no_number_up_to(
    transaction: &mut Transaction<'_, Any>,
    table: &str,
    last: i64,
) -> Result<(), StorageError> {
    for statement in [
        "INSERT INTO sqlite_sequence (name, seq) SELECT $1, 0 \
         WHERE $2 > 0 AND NOT EXISTS (SELECT 1 FROM sqlite_sequence WHERE name = $1)",
        "UPDATE sqlite_sequence SET seq = max(seq, $2) WHERE name = $1",
    ] {
        sqlx::query(statement).bind(table).bind(last).execute(&mut **transaction).await?;
    }
    Ok(())
}

/// The database of a directory, to read all of it; a server may run on it.
pub(super) async fn open_to_read(directory: &Path) -> Result<AnyConnection, StorageError> {
    let file = directory.join(FILE_NAME);
    let missing = |source| StorageError::of_directory(directory, source);
    let outdated =
        || StorageError::Unfit(format!("{}: start this version's server on it once", directory.display()));
    file.metadata().map_err(missing)?;
    page_sums::register()?;
    match opening::file_kind(&file)? {
        FileKind::WithChecksums => {}
        FileKind::Empty | FileKind::WithoutChecksums => return Err(outdated()),
    }
    let mut connection = connect_to_read(&file).await.map_err(|error| or_no_database(error, directory))?;
    let applied: i64 =
        sqlx::query_scalar("SELECT count(*) FROM _sqlx_migrations").fetch_one(&mut connection).await?;
    if applied == sqlx::migrate!("../migrations").iter().count() as i64 {
        Ok(connection)
    } else {
        Err(outdated())
    }
}

/// Who writes the checksums, as SQLite knows it.
pub(crate) fn file_system() -> Result<&'static str, StorageError> {
    page_sums::register()?;
    Ok(page_sums::VFS)
}

/// A connection that reads a database from outside.
async fn connect_to_read(file: &Path) -> Result<AnyConnection, sqlx::Error> {
    sqlx::any::install_default_drivers();
    let file = std::path::absolute(file)?;
    AnyConnection::connect(&address(&file, Access::Read)).await
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

/// Writers wait until this is dropped.
struct Compacting<'a>(&'a AtomicBool);

impl<'a> Compacting<'a> {
    fn begin(compacting: &'a AtomicBool) -> Self {
        compacting.store(true, Ordering::Relaxed);
        Self(compacting)
    }
}

impl Drop for Compacting<'_> {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}
