//! The database of a data directory, looked into and changed from outside of a server.

use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;

/// How to open it so that what is written has its checksums, as when a server wrote it.
pub(crate) fn database_options(directory: &Path) -> SqliteConnectOptions {
    let file_system = waypost_server::offline::file_system_with_checksums().unwrap();
    SqliteConnectOptions::new().filename(directory.join("waypost.sqlite")).vfs(file_system)
}
