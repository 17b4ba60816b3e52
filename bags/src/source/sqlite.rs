//! rosbag2's SQLite, compressed by file, by message or not at all.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags};
use tempfile::NamedTempFile;

use super::{Body, Channel, Ending, RawMessage, Visit};
use crate::bytes::Encoding;
use crate::error::BagError;
use crate::input::{Input, MOST_MESSAGE_BYTES, Progress, is_compressed, zstd_decoder};

const MAGIC: &[u8] = b"SQLite format 3\0";
/// Plain CDR begins with a zero, so that nothing else begins like this.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// How much a compressed database may grow: images hardly do, and a bomb fills no disk.
const MOST_GROWTH: u64 = 256;
const MOST_GROWTH_FROM_BYTES: u64 = 64 << 20;

/// Reads a file in the order of recording, whatever its index says.
pub(super) fn read(
    path: &Path,
    progress: &mut Progress<'_>,
    visit: &mut Visit<'_>,
) -> Result<Ending, BagError> {
    let plain = if is_compressed(path) { Some(decompressed(path, &mut |_, _| {})?) } else { None };
    let file = plain.as_ref().map_or(path, NamedTempFile::path);
    check_magic(path, file)?;
    let failed = |source| BagError::Database { path: path.to_owned(), source };
    let database = open(file).map_err(failed)?;
    if !has_tables(&database).map_err(failed)? {
        let reason = "it has no tables topics and messages, as a database of rosbag2 has".to_owned();
        return Err(BagError::NotABag { path: path.to_owned(), reason });
    }
    let channels = channels(&database).map_err(failed)?;
    let size = std::fs::metadata(file).map_or(0, |metadata| metadata.len());
    let mut done = 0;
    let mut statement = database
        .prepare("SELECT topic_id, timestamp, length(data), CASE WHEN length(data) <= ?1 THEN data END FROM messages ORDER BY id")
        .map_err(failed)?;
    let mut rows = statement.query([MOST_MESSAGE_BYTES as i64]).map_err(failed)?;
    let mut buffer = Vec::new();
    while let Some(row) = rows.next().map_err(failed)? {
        let (topic, log_ns): (i64, i64) = (row.get(0).map_err(failed)?, row.get(1).map_err(failed)?);
        let size_bytes = row.get::<_, Option<i64>>(2).map_err(failed)?.unwrap_or(0);
        let Some(channel) = channels.get(&topic) else {
            return Err(BagError::Damaged {
                path: path.to_owned(),
                at_byte: done,
                problem: format!("a message is of topic {topic}, which nothing describes"),
                mend: "record it anew",
            });
        };
        let body = match row.get_ref(3).map_err(failed)? {
            ValueRef::Blob(data) if data.starts_with(ZSTD_MAGIC) => decompressed_message(data, &mut buffer),
            ValueRef::Blob(data) => Body::Whole(data),
            _ => Body::TooLong(size_bytes.unsigned_abs()),
        };
        done += size_bytes.unsigned_abs();
        progress(done.min(size), size);
        if visit(&RawMessage { channel, log_ns, body })?.is_break() {
            break;
        }
    }
    Ok(Ending::Whole)
}

fn open(file: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Connection::open_with_flags(file, flags)
}

/// Views of those names could go on for ever.
fn has_tables(database: &Connection) -> rusqlite::Result<bool> {
    let query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')";
    Ok(database.query_row(query, [], |row| row.get::<_, i64>(0))? == 2)
}

fn channels(database: &Connection) -> rusqlite::Result<HashMap<i64, Channel>> {
    let mut statement = database.prepare("SELECT id, name, type, serialization_format FROM topics")?;
    let rows = statement.query_map([], |row| {
        let encoding = match row.get::<_, String>(3)?.as_str() {
            "cdr" => Encoding::Cdr,
            other => Encoding::Other(other.to_owned()),
        };
        Ok((row.get(0)?, Channel { topic: row.get(1)?, type_name: row.get(2)?, encoding }))
    })?;
    rows.collect()
}

fn check_magic(path: &Path, file: &Path) -> Result<(), BagError> {
    let mut magic = Vec::new();
    let read = File::open(file).and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut magic));
    read.map_err(|source| BagError::File { path: path.to_owned(), source })?;
    if magic == MAGIC {
        return Ok(());
    }
    let reason = "it does not begin as SQLite does; check the file, or record it anew".to_owned();
    Err(BagError::NotABag { path: path.to_owned(), reason })
}

fn decompressed_message<'a>(data: &[u8], buffer: &'a mut Vec<u8>) -> Body<'a> {
    buffer.clear();
    let read =
        zstd_decoder(data).and_then(|decoder| decoder.take(MOST_MESSAGE_BYTES + 1).read_to_end(buffer));
    match read {
        Ok(size) if size as u64 > MOST_MESSAGE_BYTES => Body::TooLong(size as u64),
        Ok(_) => Body::Whole(buffer),
        Err(error) => Body::Unreadable(error.to_string()),
    }
}

/// The database of a compressed file, beside the system's other temporary files: SQLite needs to seek in it.
fn decompressed(path: &Path, progress: &mut Progress<'_>) -> Result<NamedTempFile, BagError> {
    let failed = |source| BagError::File { path: path.to_owned(), source };
    let mut input = Input::open(path, progress)?;
    let most_bytes = MOST_GROWTH_FROM_BYTES.max(input.size().saturating_mul(MOST_GROWTH));
    let mut plain = NamedTempFile::new().map_err(failed)?;
    let written = io::copy(&mut (&mut input).take(most_bytes + 1), &mut plain).map_err(failed)?;
    if written > most_bytes {
        return Err(BagError::Damaged {
            path: path.to_owned(),
            at_byte: written,
            problem: format!("it decompresses to more than {most_bytes} bytes"),
            mend: "decompress it with `zstd -d` if it is what you expect",
        });
    }
    plain.seek(SeekFrom::Start(0)).map_err(failed)?;
    Ok(plain)
}
