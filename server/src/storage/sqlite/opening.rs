//! The database file as a server needs it: made where it is missing, and written anew with checksums where an earlier
//! version wrote it.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use super::lock::make_private;
use super::page_sums::{self, PAGE_BYTES, RESERVED_AT, SUM_BYTES, is_sound};
use super::{FILE_NAME, or_no_database};
use crate::storage::StorageError;

/// What every database of SQLite begins with.
const MAGIC: &[u8] = b"SQLite format 3\0";

/// Where the database is written anew; left behind by a server that was killed meanwhile.
const WRITTEN_ANEW: &str = "waypost.sqlite.with-checksums";

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileKind {
    Empty,
    WithChecksums,
    /// As servers wrote them before there were checksums.
    WithoutChecksums,
}

/// Sees to it that the database of `directory` is there and has checksums.
pub(super) async fn prepare(directory: &Path) -> Result<(), StorageError> {
    page_sums::register()?;
    let file = directory.join(FILE_NAME);
    make_private(&file);
    match file_kind(&file)? {
        FileKind::Empty => create(&file).await,
        FileKind::WithChecksums => Ok(()),
        FileKind::WithoutChecksums => write_anew(directory).await,
    }
}

/// What the file is, by its first page.
pub(super) fn file_kind(file: &Path) -> Result<FileKind, StorageError> {
    let failed = |source| StorageError::Directory { directory: file.to_owned(), source };
    let mut page = Vec::new();
    let opened = File::open(file).map_err(failed)?;
    opened.take(PAGE_BYTES as u64).read_to_end(&mut page).map_err(failed)?;
    if page.is_empty() {
        return Ok(FileKind::Empty);
    }
    let Some(reserved) = page.get_mut(RESERVED_AT) else {
        return Err(StorageError::NoDatabase { path: file.to_owned() });
    };
    let found = usize::from(*reserved);
    // With one bit of its header another, a file would seem to be of an earlier version.
    *reserved = SUM_BYTES as u8;
    let has_checksum = is_sound(1, &page);
    if !page.starts_with(MAGIC) {
        return Err(StorageError::NoDatabase { path: file.to_owned() });
    }
    match found {
        SUM_BYTES => Ok(FileKind::WithChecksums),
        0 if !has_checksum => Ok(FileKind::WithoutChecksums),
        _ => {
            let reason = "its first page is not as it was written".to_owned();
            Err(StorageError::Broken { path: file.to_owned(), reason })
        }
    }
}

async fn create(file: &Path) -> Result<(), StorageError> {
    let options = SqliteConnectOptions::new().filename(file).vfs(page_sums::VFS).create_if_missing(true);
    let mut connection = options.connect().await?;
    page_sums::reserve(&mut connection).await?;
    // Writes the first page.
    sqlx::query("PRAGMA journal_mode = WAL").execute(&mut connection).await?;
    Ok(connection.close().await?)
}

/// The old file is there until the new one is whole.
async fn write_anew(directory: &Path) -> Result<(), StorageError> {
    let (old, new) = (directory.join(FILE_NAME), directory.join(WRITTEN_ANEW));
    let failed = |source| StorageError::Directory { directory: directory.to_owned(), source };
    tracing::info!(
        "the database is written anew, with checksums; this is done once and takes its size again on the disk"
    );
    if new.exists() {
        std::fs::remove_file(&new).map_err(failed)?;
    }
    make_private(&new);
    let mut connection = SqliteConnectOptions::new()
        .filename(&old)
        .connect()
        .await
        .map_err(|error| or_no_database(error, directory))?;
    let copied = async {
        // SQLite must know the old pages before it hears of the new ones.
        sqlx::query("SELECT count(*) FROM sqlite_schema").execute(&mut connection).await?;
        page_sums::reserve(&mut connection).await?;
        sqlx::query("VACUUM INTO ?").bind(with_checksums(&new)).execute(&mut connection).await?;
        Ok(())
    };
    let copied: Result<(), StorageError> = copied.await;
    // Folds the write-ahead log in, and removes it.
    connection.close().await?;
    if let Err(error) = copied {
        std::fs::remove_file(&new).map_err(failed)?;
        return Err(error);
    }
    let log = directory.join(format!("{FILE_NAME}-wal"));
    if log.metadata().is_ok_and(|log| log.len() > 0) {
        return Err(StorageError::Locked { directory: directory.to_owned() });
    }
    File::open(&new).and_then(|file| file.sync_all()).map_err(failed)?;
    std::fs::rename(&new, &old).map_err(failed)?;
    File::open(directory).and_then(|directory| directory.sync_all()).map_err(failed)
}

/// The name of a file for SQLite, with who writes it.
fn with_checksums(file: &Path) -> String {
    format!("file:{}?vfs={}", percent_encoded(file), page_sums::VFS)
}

/// A path as it may stand in an address.
pub(super) fn percent_encoded(path: &Path) -> String {
    let mut encoded = String::new();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'/' | b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' => encoded.push(char::from(*byte)),
            other => encoded.push_str(&format!("%{other:02X}")),
        }
    }
    encoded
}
