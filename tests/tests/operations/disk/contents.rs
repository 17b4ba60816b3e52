//! What a database holds, as one number: two databases of the same number hold the same rows.

use std::collections::BTreeMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::Path;

use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row};

use crate::harness::database_options;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Contents {
    digest: u64,
    /// Frames that the log has, by map and session.
    pub(super) frames: BTreeMap<(String, String), u64>,
}

impl Contents {
    pub(super) fn digest(&self) -> u64 {
        self.digest
    }
}

/// What the database of a data directory holds, as SQLite recovers it. What is wrong with it, if SQLite finds anything.
pub(super) async fn contents(data: &Path) -> Result<Contents, String> {
    let file = data.join("waypost.sqlite");
    if file.metadata().map_or(0, |file| file.len()) == 0 {
        return Ok(Contents::default());
    }
    let mut database = database_options(data).connect().await.map_err(|error| error.to_string())?;
    let read = read(&mut database).await.map_err(|error| error.to_string());
    database.close().await.map_err(|error| error.to_string())?;
    let (contents, told) = read?;
    if told != ["ok"] {
        return Err(format!("SQLite finds {told:?}"));
    }
    Ok(contents)
}

async fn read(database: &mut SqliteConnection) -> Result<(Contents, Vec<String>), sqlx::Error> {
    let told = sqlx::query_scalar("PRAGMA integrity_check(3)").fetch_all(&mut *database).await?;
    let tables: Vec<String> =
        sqlx::query_scalar("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name")
            .fetch_all(&mut *database)
            .await?;
    let mut hasher = DefaultHasher::new();
    for table in &tables {
        // Not when it was migrated, nor how long that took.
        let columns = if table == "_sqlx_migrations" { "version, checksum, success" } else { "*" };
        let rows = sqlx::query(AssertSqlSafe(format!("SELECT {columns} FROM \"{table}\"")))
            .fetch_all(&mut *database);
        let mut sum = 0_u64;
        for row in rows.await? {
            let mut hasher = DefaultHasher::new();
            for column in 0..row.len() {
                row.try_get_unchecked::<Option<&[u8]>, _>(column)?.hash(&mut hasher);
            }
            // Whatever their order.
            sum = sum.wrapping_add(hasher.finish());
        }
        (table, sum).hash(&mut hasher);
    }
    let mut frames = Vec::new();
    if tables.iter().any(|table| table == "log") {
        let select = "SELECT maps.name, sessions.name, count(*) FROM log JOIN maps ON maps.id = log.map_id \
                      JOIN sessions ON sessions.map_id = log.map_id AND sessions.number = log.session \
                      WHERE sequence IS NOT NULL GROUP BY 1, 2";
        frames = sqlx::query_as(select).fetch_all(&mut *database).await?;
    }
    let frames = frames.into_iter().map(|(map, session, count)| ((map, session), count)).collect();
    let digest = if tables.is_empty() { 0 } else { hasher.finish() };
    Ok((Contents { digest, frames }, told))
}
