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
///
/// When the power fails while that is written, it is nothing, and the write-ahead log has it whole: SQLite takes it from
/// there.
pub(super) fn file_kind(file: &Path) -> Result<FileKind, StorageError> {
    let failed = |source| StorageError::of_directory(file, source);
    let mut page = Vec::new();
    let opened = File::open(file).map_err(failed)?;
    opened.take(PAGE_BYTES as u64).read_to_end(&mut page).map_err(failed)?;
    let mut log = file.as_os_str().to_owned();
    log.push("-wal");
    let has_log = Path::new(&log).metadata().is_ok_and(|log| log.len() > 0);
    match (page.is_empty(), has_log) {
        (true, false) => Ok(FileKind::Empty),
        // SQLite would throw the log away.
        (true, true) => {
            let reason = "it is empty, and the write-ahead log beside it is not".to_owned();
            Err(StorageError::Broken { path: file.to_owned(), reason })
        }
        (false, false) => kind_of_page(file, page),
        (false, true) => kind_of_page(file, page).or(Ok(FileKind::WithChecksums)),
    }
}

fn kind_of_page(file: &Path, mut page: Vec<u8>) -> Result<FileKind, StorageError> {
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
    let failed = |source| StorageError::of_directory(directory, source);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A database that is in use: all of it is in the write-ahead log.
    async fn copied(change: impl FnOnce(&mut Vec<u8>)) -> (tempfile::TempDir, SqliteConnectOptions) {
        let directory = tempfile::tempdir().unwrap();
        let (used, copy) = (directory.path().join("used"), directory.path().join("copy"));
        for directory in [&used, &copy] {
            std::fs::create_dir(directory).unwrap();
        }
        let file = used.join(FILE_NAME);
        File::create(&file).unwrap();
        prepare(&used).await.unwrap();
        let options = |directory: &Path| {
            SqliteConnectOptions::new().filename(directory.join(FILE_NAME)).vfs(page_sums::VFS)
        };
        let mut connection = options(&used).connect().await.unwrap();
        sqlx::query("CREATE TABLE kept (number INTEGER)").execute(&mut connection).await.unwrap();
        sqlx::query("INSERT INTO kept VALUES (7)").execute(&mut connection).await.unwrap();
        let mut content = std::fs::read(&file).unwrap();
        change(&mut content);
        std::fs::write(copy.join(FILE_NAME), content).unwrap();
        let log = format!("{FILE_NAME}-wal");
        std::fs::copy(used.join(&log), copy.join(&log)).unwrap();
        connection.close().await.unwrap();
        (directory, options(&copy))
    }

    #[tokio::test]
    async fn a_first_page_that_was_not_written_whole_is_taken_from_the_log() {
        let garbage = |content: &mut Vec<u8>| (0..PAGE_BYTES).for_each(|at| content[at] = at as u8 ^ 0x5a);
        let zeros = |content: &mut Vec<u8>| content[..PAGE_BYTES].fill(0);
        let torn = |content: &mut Vec<u8>| content[512..PAGE_BYTES].fill(0xff);
        for change in [garbage as fn(&mut Vec<u8>), zeros, torn] {
            let (directory, options) = copied(change).await;
            let copy = directory.path().join("copy");
            prepare(&copy).await.unwrap();
            let mut connection = options.connect().await.unwrap();
            let kept: i64 =
                sqlx::query_scalar("SELECT number FROM kept").fetch_one(&mut connection).await.unwrap();
            assert_eq!(kept, 7);
            connection.close().await.unwrap();
        }
    }

    #[tokio::test]
    async fn an_empty_file_beside_a_log_is_no_new_database() {
        let (directory, _options) = copied(Vec::clear).await;
        let refused = prepare(&directory.path().join("copy")).await.unwrap_err().to_string();
        assert!(refused.contains("it is empty, and the write-ahead log beside it is not"), "{refused}");
    }
}
