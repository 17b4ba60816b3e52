//! The database of a data directory, looked into and changed from outside of a server.

use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AnyConnection, Connection};
use waypost_server::config::StorageAddress;

use super::postgres::location;

/// Its tables, whichever database has them; see [`location`].
pub(crate) async fn tables(directory: &Path) -> AnyConnection {
    sqlx::any::install_default_drivers();
    match location(directory).await.storage {
        StorageAddress::Postgres(url) => AnyConnection::connect(&url).await.unwrap(),
        StorageAddress::Sqlite => {
            let file_system = waypost_server::offline::file_system_with_checksums().unwrap();
            let file = directory.join("waypost.sqlite");
            let url = format!("sqlite://{}?mode=rw&vfs={file_system}", file.display());
            let mut connection = AnyConnection::connect(&url).await.unwrap();
            let settings = "PRAGMA busy_timeout = 30000; PRAGMA foreign_keys = ON";
            sqlx::raw_sql(settings).execute(&mut connection).await.unwrap();
            connection
        }
    }
}

/// How to open it so that what is written has its checksums, as when a server wrote it.
pub(crate) fn database_options(directory: &Path) -> SqliteConnectOptions {
    let file_system = waypost_server::offline::file_system_with_checksums().unwrap();
    SqliteConnectOptions::new().filename(directory.join("waypost.sqlite")).vfs(file_system)
}
