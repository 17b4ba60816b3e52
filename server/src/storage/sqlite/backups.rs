//! Copies of all that a data directory holds, and data directories made of them.

use std::fs::File;
use std::io;
use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use super::lock::{DirectoryLock, make_directory, make_private};
use super::opening::{FileKind, file_kind};
use super::{BUSY_TIMEOUT, FILE_NAME, or_no_database, page_sums};
use crate::storage::StorageError;

/// What a copy is called until it is whole.
const PARTIAL_NAME: &str = "waypost.sqlite.partial";

/// Writes a copy of the database of `data_dir` as it is now into `directory`, which is made. A server may run on
/// `data_dir`, and robots stream; the copy holds each transaction whole or not at all.
pub(crate) async fn back_up(data_dir: &Path, directory: &Path) -> Result<(), StorageError> {
    page_sums::register()?;
    let source = data_dir.join(FILE_NAME);
    if !source.exists() {
        return Err(StorageError::NothingThere { directory: data_dir.to_owned() });
    }
    match file_kind(&source)? {
        FileKind::WithChecksums => {}
        FileKind::Empty | FileKind::WithoutChecksums => {
            let reason = "it has no checksums yet: start this version's server on it once".to_owned();
            return Err(StorageError::Broken { path: source, reason });
        }
    }
    let failed = |source| StorageError::of_directory(directory, source);
    make_for(directory, FILE_NAME).map_err(failed)?;
    let partial = directory.join(PARTIAL_NAME);
    if partial.exists() {
        std::fs::remove_file(&partial).map_err(failed)?;
    }
    make_private(&partial);
    let options = SqliteConnectOptions::new()
        .filename(&source)
        .vfs(page_sums::VFS)
        .read_only(true)
        .busy_timeout(BUSY_TIMEOUT);
    let mut database = options.connect().await.map_err(|error| or_no_database(error, data_dir))?;
    let copied = sqlx::query("VACUUM INTO ?").bind(partial.to_string_lossy()).execute(&mut database).await;
    database.close().await?;
    if let Err(error) = copied {
        std::fs::remove_file(&partial).map_err(failed)?;
        return Err(or_no_database(error, data_dir));
    }
    forget_tasks(&partial).await?;
    put_in_place(directory, &partial).map_err(failed)
}

/// Jobs that run do not go on in the copy: who brings it back wants what was there then.
async fn forget_tasks(copy: &Path) -> Result<(), StorageError> {
    let mut database = SqliteConnectOptions::new().filename(copy).vfs(page_sums::VFS).connect().await?;
    // A database of an earlier version has none.
    let there = sqlx::query("SELECT 1 FROM pragma_table_info('jobs') WHERE name = 'task'");
    if there.fetch_optional(&mut database).await?.is_some() {
        sqlx::query("UPDATE jobs SET task = NULL WHERE state = 'running'").execute(&mut database).await?;
    }
    Ok(database.close().await?)
}

/// Makes `data_dir`, which must hold no database, what a backup in `directory` is.
pub(crate) async fn restore(directory: &Path, data_dir: &Path) -> Result<(), StorageError> {
    let _lock = DirectoryLock::take(data_dir)?;
    let failed = |source| StorageError::of_directory(data_dir, source);
    make_for(data_dir, FILE_NAME).map_err(failed)?;
    // SQLite would take the write-ahead log of a database that was moved away for that of this one.
    make_for(data_dir, &format!("{FILE_NAME}-wal")).map_err(failed)?;
    let partial = data_dir.join(PARTIAL_NAME);
    make_private(&partial);
    if let Err(error) = std::fs::copy(directory.join(FILE_NAME), &partial) {
        // What there is of it is of no use, and may have filled the disk.
        std::fs::remove_file(&partial).map_err(failed)?;
        return Err(failed(error));
    }
    put_in_place(data_dir, &partial).map_err(failed)
}

/// Makes a directory for a file that must not be there yet.
fn make_for(directory: &Path, name: &str) -> io::Result<()> {
    make_directory(directory)?;
    let path = directory.join(name);
    // A file without a byte holds nothing.
    if path.metadata().is_ok_and(|file| file.len() > 0) {
        let message = format!("{} is there already; move it away first", path.display());
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, message));
    }
    Ok(())
}

/// Gives a whole copy its name, once it is on the disk.
fn put_in_place(directory: &Path, partial: &Path) -> io::Result<()> {
    File::open(partial)?.sync_all()?;
    std::fs::rename(partial, directory.join(FILE_NAME))?;
    File::open(directory)?.sync_all()
}
