//! Databases from before there were checksums.

use std::path::Path;

use sqlx::migrate::Migrator;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};
use waypost_client::v1;

use super::{deep, note, two_maps};
use crate::harness::{Server, answers, database_options, frame, workspace};

/// The last migrations of servers that knew no checksums, and whether they kept notes of frames.
const LAST_WITHOUT: [(i64, bool); 2] = [(9, false), (10, true)];

const TABLES: [&str; 9] =
    ["models", "maps", "sessions", "log", "frame_media", "frame_notes", "labels", "map_models", "jobs"];

async fn execute(database: &mut SqliteConnection, statement: String) {
    sqlx::query(AssertSqlSafe(statement)).execute(database).await.unwrap();
}

/// Writes what a directory holds as a server with migrations up to `last` had it; no checkpoint, which may always be missing.
async fn as_it_was(directory: &Path, last: i64, old: &Path) {
    let mut migrator = Migrator::new(workspace().join("migrations")).await.unwrap();
    migrator.migrations = migrator.iter().filter(|one| one.version <= last).cloned().collect();
    let file = old.join("waypost.sqlite");
    let mut database =
        SqliteConnectOptions::new().filename(&file).create_if_missing(true).connect().await.unwrap();
    migrator.run(&mut database).await.unwrap();
    let mut columns = Vec::new();
    for table in TABLES {
        let names: Vec<String> = sqlx::query_scalar("SELECT name FROM pragma_table_info(?)")
            .bind(table)
            .fetch_all(&mut database)
            .await
            .unwrap();
        // The table is of a later migration.
        if !names.is_empty() {
            columns.push((table, names.join(", ")));
        }
    }
    database.close().await.unwrap();
    let mut database = database_options(directory).connect().await.unwrap();
    execute(&mut database, format!("ATTACH 'file:{}?vfs=unix' AS old", file.display())).await;
    for (table, columns) in columns {
        execute(
            &mut database,
            format!("INSERT INTO old.{table} ({columns}) SELECT {columns} FROM main.{table}"),
        )
        .await;
    }
    database.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_without_checksums_gets_them_once_and_is_the_same() {
    let directory = two_maps().await;
    let server = Server::start_on(directory.path()).await;
    let before = server.client().await.map("drive", v1::MapView::Full).await.unwrap();
    server.stop().await;
    for (last, notes) in LAST_WITHOUT {
        let old = tempfile::tempdir().unwrap();
        as_it_was(directory.path(), last, old.path()).await;
        let raw = std::fs::read(old.path().join("waypost.sqlite")).unwrap();
        assert_eq!(raw[20], 0, "it has room for checksums already");
        let told = deep(old.path()).await;
        assert!(told.len() == 1 && told[0].contains("no checksums yet"), "{told:?}");
        // What a server that was killed meanwhile has left.
        std::fs::write(old.path().join("waypost.sqlite.with-checksums"), b"half of it").unwrap();
        for start in ["first", "second"] {
            is_the_same(old.path(), &before, start, notes).await;
        }
        let left: Vec<_> =
            std::fs::read_dir(old.path()).unwrap().map(|file| file.unwrap().file_name()).collect();
        assert!(!left.iter().any(|name| name.to_string_lossy().contains("with-checksums")), "{left:?}");
    }
}

async fn is_the_same(old: &Path, before: &v1::Map, start: &str, notes: bool) {
    let server = Server::start_on(old).await;
    let client = server.client().await;
    let after = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!((&after.state_hash, after.frames), (&before.state_hash, before.frames), "{start}");
    let frame_7 = client.frame("maps/drive/sessions/first/frames/7").await.unwrap();
    assert_eq!(frame_7.note, if notes { note(7) } else { String::new() });
    assert_eq!(answers(&client, "spare", start, (1..=2).map(frame)).await.len(), 2);
    server.stop().await;
    assert_eq!(deep(old).await, [""; 0], "{start}");
}
