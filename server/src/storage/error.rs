//! What goes wrong with a database, and what its own codes mean.

use std::path::{Path, PathBuf};

use sqlx::error::DatabaseError;
use sqlx::migrate::MigrateError;
use sqlx::postgres::PgDatabaseError;
use sqlx::sqlite::SqliteError;

use crate::quotas::OverQuota;

/// What went wrong with the database.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StorageError {
    #[error(
        "cannot use the data directory {directory}: {reason}; give a directory that this user may write to"
    )]
    Directory { directory: PathBuf, reason: std::io::Error },
    #[error("{directory} holds no database; name the data directory of a server with --data-dir")]
    NothingThere { directory: PathBuf },
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
    #[error("the media store {address} does not do what it is asked: {reason}")]
    MediaHeldUp { address: String, reason: String },
    #[error("something of this name is there already")]
    Exists,
    #[error("it is still in use")]
    InUse,
    #[error("the job has ended already")]
    JobEnded,
    #[error("the log was rewritten, or deleted, since it was read")]
    Retold,
    #[error("a text has the character U+0000, which no name, label or note has; leave it out")]
    NoText,
    #[error("whoever asked for it has gone")]
    Abandoned,
    #[error("the database holds what cannot be read: {0}; restore it from a copy")]
    Damaged(String),
    #[error("{0}")]
    Rot(String),
    #[error("the model {hash}: {found}")]
    DamagedModel { hash: String, found: String },
    #[error(
        "the map takes nothing more since damage was found in it: {0}; `waypost-server check --deep` tells all of it; \
         `waypost map repair` makes a new map of what is left, and of a snapshot"
    )]
    ReadOnly(String),
    #[error("{0}")]
    OverQuota(#[from] OverQuota),
    #[error("the database failed: {0}")]
    Failed(sqlx::Error),
    #[error(
        "this server no longer owns the database: another has taken over; stop this one, and send robots to that one"
    )]
    TakenOver,
    #[error(
        "a server owns the database ({owner}); ask that one, as by `waypost token`, or stop it and try again in some \
         seconds"
    )]
    Owned { owner: String },
    #[error("{0}")]
    Unfit(String),
    #[error(
        "the database could not be brought up to date: {0}; use the version that wrote it, or restore it from a backup"
    )]
    Migration(MigrateError),
}

impl StorageError {
    /// What went wrong with a directory, or a file in it.
    pub(super) fn of_directory(directory: &Path, error: std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::StorageFull => Self::DiskFull(sqlx::Error::Io(error)),
            _ => Self::Directory { directory: directory.to_owned(), reason: error },
        }
    }
}

impl StorageError {
    /// What went wrong with the file of a model.
    pub(super) fn of_model(hash: &str, error: sqlx::Error) -> Self {
        match Self::from(error) {
            Self::Rot(found) => Self::DamagedModel { hash: hash.to_owned(), found },
            other => other,
        }
    }

    /// That the database is held up, for want of a better word.
    pub(super) fn held_up(cause: &Self) -> Self {
        Self::HeldUp(sqlx::Error::Io(std::io::Error::other(cause.to_string())))
    }

    /// The same for somebody else, where it befalls whoever writes; `None` where it may be of one transaction alone.
    pub(super) fn befalls_all(&self) -> Option<Self> {
        // What the database said cannot be copied: its words can.
        let again = |source: &sqlx::Error| sqlx::Error::Io(std::io::Error::other(source.to_string()));
        match self {
            Self::DiskFull(source) => Some(Self::DiskFull(again(source))),
            Self::HeldUp(source) => Some(Self::HeldUp(again(source))),
            Self::TakenOver => Some(Self::TakenOver),
            Self::Directory { .. }
            | Self::NothingThere { .. }
            | Self::Locked { .. }
            | Self::Newer { .. }
            | Self::NoDatabase { .. }
            | Self::Broken { .. }
            | Self::MediaHeldUp { .. }
            | Self::Exists
            | Self::InUse
            | Self::JobEnded
            | Self::Retold
            | Self::NoText
            | Self::Abandoned
            | Self::Damaged(_)
            | Self::Rot(_)
            | Self::DamagedModel { .. }
            | Self::ReadOnly(_)
            | Self::OverQuota(_)
            | Self::Failed(_)
            | Self::Owned { .. }
            | Self::Unfit(_)
            | Self::Migration(_) => None,
        }
    }
}

/// SQLite's primary result codes.
const SQLITE_BUSY: u32 = 5;
const SQLITE_LOCKED: u32 = 6;
const SQLITE_IOERR: u32 = 10;
const SQLITE_CORRUPT: u32 = 11;
const SQLITE_FULL: u32 = 13;
const SQLITE_CANTOPEN: u32 = 14;
pub(super) const SQLITE_NOTADB: u32 = 26;

/// The whole result code of SQLite where a page is not as it was written.
const SQLITE_IOERR_DATA: &str = "8202";

/// The primary result code of SQLite, if it was SQLite that failed.
pub(super) fn primary_code(error: &sqlx::Error) -> Option<u32> {
    let sqlite = error.as_database_error()?.try_downcast_ref::<SqliteError>()?;
    let extended: u32 = sqlite.code()?.parse().ok()?;
    Some(extended & 0xff)
}

/// What PostgreSQL says of an error that it makes itself, as far as that matters here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PostgresTrouble {
    /// It may work a little later: the database starts, stops, is a standby, is busy, or was cut off.
    HeldUp,
    DiskFull,
    Rot,
    NoText,
}

/// By the classes and codes of SQLSTATE.
fn postgres_trouble(error: &sqlx::Error) -> Option<PostgresTrouble> {
    let error = error.as_database_error()?.try_downcast_ref::<PgDatabaseError>()?;
    match error.code() {
        "53100" => Some(PostgresTrouble::DiskFull),
        "XX001" | "XX002" => Some(PostgresTrouble::Rot),
        "22021" => Some(PostgresTrouble::NoText),
        // A standby; a lock, or a statement, that took too long; deadlock; serialization.
        "25006" | "55P03" | "57014" | "40P01" | "40001" => Some(PostgresTrouble::HeldUp),
        code if ["08", "53", "57", "58"].iter().any(|class| code.starts_with(class)) => {
            Some(PostgresTrouble::HeldUp)
        }
        _ => None,
    }
}

/// Whether the database met what is not as it was written.
pub(super) fn is_rot(error: &sqlx::Error) -> bool {
    let checksum = error
        .as_database_error()
        .and_then(|error| error.try_downcast_ref::<SqliteError>())
        .and_then(DatabaseError::code)
        .is_some_and(|code| code == SQLITE_IOERR_DATA);
    checksum
        || primary_code(error) == Some(SQLITE_CORRUPT)
        || postgres_trouble(error) == Some(PostgresTrouble::Rot)
}

impl From<sqlx::Error> for StorageError {
    fn from(error: sqlx::Error) -> Self {
        if let sqlx::Error::ColumnDecode { .. } = &error {
            return Self::Damaged(error.to_string());
        }
        // Closed, where the database may be another server's.
        if let sqlx::Error::PoolTimedOut | sqlx::Error::PoolClosed = &error {
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
        // A database of PostgreSQL that is cut off, in whatever its connection was at.
        if let sqlx::Error::Io(_) | sqlx::Error::Tls(_) | sqlx::Error::Protocol(_) = &error {
            return Self::HeldUp(error);
        }
        match postgres_trouble(&error) {
            Some(PostgresTrouble::HeldUp) => return Self::HeldUp(error),
            Some(PostgresTrouble::DiskFull) => return Self::DiskFull(error),
            Some(PostgresTrouble::NoText) => return Self::NoText,
            Some(PostgresTrouble::Rot) | None => {}
        }
        match primary_code(&error) {
            Some(SQLITE_FULL) => Self::DiskFull(error),
            Some(SQLITE_BUSY | SQLITE_LOCKED | SQLITE_IOERR | SQLITE_CANTOPEN) => Self::HeldUp(error),
            Some(_) | None => Self::Failed(error),
        }
    }
}
