//! Looking at a database without serving it.

use std::path::Path;

use sqlx::SqlitePool;
use sqlx::migrate::MigrateError;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};

use super::deep_inspection::in_one_line;
use super::lock::DirectoryLock;
use super::opening::{FileKind, file_kind};
use super::{FILE_NAME, or_no_database, page_sums};
use crate::storage::StorageError;
use crate::storage::connections::of_any_age;

/// What a data directory holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inspection {
    pub(crate) maps: u64,
    pub(crate) tokens: u64,
    /// Whether the next server to open it brings it up to date.
    pub(crate) outdated: bool,
}

/// Looks at the database of `directory` and changes nothing in it. `None` if there is none yet.
///
/// Takes the directory's lock meanwhile: a server that runs on it is an error.
pub(crate) async fn inspect(directory: &Path) -> Result<Option<Inspection>, StorageError> {
    let _lock = DirectoryLock::take(directory)?;
    let file = directory.join(FILE_NAME);
    if !file.exists() {
        return Ok(None);
    }
    page_sums::register()?;
    let options = SqliteConnectOptions::new().read_only(true);
    let (options, without_checksums) = match file_kind(&file)? {
        FileKind::Empty => return Ok(None),
        FileKind::WithChecksums => (options.vfs(page_sums::VFS), false),
        FileKind::WithoutChecksums => (options, true),
    };
    let options = options.filename(file);
    let database = of_any_age(SqlitePoolOptions::new()).max_connections(1).connect_with(options).await;
    let database = database.map_err(|error| or_no_database(error, directory))?;
    let inspected = look_at(&database).await;
    database.close().await;
    match inspected {
        Ok(inspection) => {
            Ok(Some(Inspection { outdated: inspection.outdated || without_checksums, ..inspection }))
        }
        Err(StorageError::Failed(error)) => Err(or_no_database(error, directory)),
        Err(error) => Err(error),
    }
}

async fn look_at(database: &SqlitePool) -> Result<Inspection, StorageError> {
    let problem: String = sqlx::query_scalar("PRAGMA quick_check(1)").fetch_one(database).await?;
    if problem != "ok" {
        return Err(StorageError::Damaged(in_one_line(&problem)));
    }
    let outdated = look_at_migrations(database).await?;
    let maps = sqlx::query_scalar("SELECT count(*) FROM maps").fetch_one(database).await?;
    // A database of the first version has no tokens.
    let has_tokens = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = 'tokens'";
    let tokens = match sqlx::query_scalar(has_tokens).fetch_one(database).await? {
        0_i64 => 0,
        _ => sqlx::query_scalar("SELECT count(*) FROM tokens").fetch_one(database).await?,
    };
    Ok(Inspection { maps, tokens, outdated })
}

/// Whether there are later ones; an error where those that there are would keep a server from starting.
async fn look_at_migrations(database: &SqlitePool) -> Result<bool, StorageError> {
    let migrator = sqlx::migrate!("../migrations");
    let applied: Vec<(i64, bool, Vec<u8>)> =
        sqlx::query_as("SELECT version, success, checksum FROM _sqlx_migrations ORDER BY version")
            .fetch_all(database)
            .await?;
    for (version, success, checksum) in &applied {
        let known = migrator.iter().find(|known| known.version == *version);
        match known {
            None => return Err(StorageError::Newer { schema: *version }),
            Some(_) if !success => return Err(StorageError::Migration(MigrateError::Dirty(*version))),
            Some(known) if known.checksum.as_ref() != checksum.as_slice() => {
                return Err(StorageError::Migration(MigrateError::VersionMismatch(*version)));
            }
            Some(_) => {}
        }
    }
    Ok(applied.len() < migrator.iter().count())
}
