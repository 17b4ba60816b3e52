//! Fold equals replay equals restore: a map is the same however it comes into memory.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row};
use waypost_client::{FrameInput, v1};

use crate::harness::{
    Server, ServerProcess, answers, as_words, database_options, first_return, import_model, map_request,
    state_hash,
};

/// A directory with a map of two sessions, one with odometry, that loops; left by SIGTERM.
struct Stored {
    directory: tempfile::TempDir,
    map: v1::Map,
    places: Vec<v1::Place>,
    matches: Vec<v1::LoopClosure>,
}

impl Stored {
    async fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let server = ServerProcess::start(directory.path());
        let client = server.client().await;
        let model = import_model(&client).await;
        client.create_map(map_request("drive", &model.name)).await.unwrap();
        answers(&client, "drive", "first", (1..=25).map(with_odometry)).await;
        let again = first_return();
        answers(&client, "drive", "second", (again..again + 20).map(as_words)).await;
        let map = client.map("drive", v1::MapView::Full).await.unwrap();
        assert!(map.links > 0 && map.loop_closures > 0, "{map:?}");
        let places = client.places("drive").await.unwrap();
        let matches = client.loop_closures("drive").await.unwrap();
        server.stop();
        Self { directory, map, places, matches }
    }

    fn path(&self) -> &Path {
        self.directory.path()
    }

    /// Opens the map anew: it must be what it was, and go on as it would have.
    async fn reopens(&self, case: &str) {
        let server = Server::start_on(self.path()).await;
        let client = server.client().await;
        let map =
            client.map("drive", v1::MapView::Full).await.unwrap_or_else(|error| panic!("{case}: {error}"));
        // What a checkpoint weighs is not what the map is.
        let expected = v1::Map { storage: map.storage, ..self.map.clone() };
        assert_eq!(map, expected, "{case}");
        assert_eq!(client.places("drive").await.unwrap(), self.places, "{case}");
        assert_eq!(client.loop_closures("drive").await.unwrap(), self.matches, "{case}");
        server.stop().await;
    }

    async fn database(&self) -> SqliteConnection {
        database_options(self.path()).foreign_keys(true).connect().await.unwrap()
    }

    async fn sql(&self, statement: &str) {
        let mut database = self.database().await;
        let done = sqlx::query(AssertSqlSafe(statement.to_owned())).execute(&mut database).await.unwrap();
        assert!(done.rows_affected() > 0, "{statement} changed nothing");
        database.close().await.unwrap();
    }

    /// Empties a table, which may be empty already.
    async fn clear(&self, table: &str) {
        let mut database = self.database().await;
        sqlx::query(AssertSqlSafe(format!("DELETE FROM {table}"))).execute(&mut database).await.unwrap();
        database.close().await.unwrap();
    }

    async fn count(&self, query: &str) -> i64 {
        let mut database = self.database().await;
        let row = sqlx::query(AssertSqlSafe(query.to_owned())).fetch_one(&mut database).await.unwrap();
        database.close().await.unwrap();
        row.get(0)
    }
}

fn with_odometry(sequence: u64) -> FrameInput {
    let odometry = v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x: 0.7 * sequence as f64, y: 0.1, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }),
        }),
        covariance: Vec::new(),
    };
    FrameInput { odometry: Some(odometry), ..as_words(sequence) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_the_same_from_checkpoint_and_replay() {
    let stored = Stored::new().await;
    let events = stored.count("SELECT count(*) FROM log").await;
    assert_eq!(stored.count("SELECT events FROM checkpoints").await, events, "SIGTERM wrote no checkpoint");
    assert_eq!(stored.count("SELECT count(*) FROM checkpoint_places").await, stored.places.len() as i64);
    stored.reopens("from the checkpoint").await;
    for table in TABLES {
        stored.clear(table).await;
    }
    stored.reopens("by full replay").await;
    // The replay wrote a checkpoint of its own, with all places in blocks.
    assert_eq!(stored.count("SELECT events FROM checkpoints").await, events);
    assert_eq!(stored.count("SELECT count(*) FROM checkpoint_places").await, 0);
    assert_eq!(stored.count("SELECT sum(places) FROM checkpoint_blocks").await, stored.places.len() as i64);
    stored.reopens("from the checkpoint after the replay").await;
    stored.sql("DELETE FROM checkpoints").await;
    stored.reopens("by replay beside an old checkpoint's pieces").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_checkpoint_is_replayed() {
    // The first leave places without a block; after that a replay has sealed them.
    const DAMAGES: [(&str, &str); 14] = [
        (
            "place cut",
            "UPDATE checkpoint_places SET content = substr(content, 1, length(content) / 2) WHERE place = 3",
        ),
        ("head cut", "UPDATE checkpoints SET head = substr(head, 1, length(head) / 2)"),
        ("head empty", "UPDATE checkpoints SET head = x''"),
        ("head of noise", "UPDATE checkpoints SET head = randomblob(500)"),
        ("head longer", "UPDATE checkpoints SET head = CAST(head || x'00' AS BLOB)"),
        ("sessions missing", "DELETE FROM checkpoint_sessions WHERE session = 1"),
        (
            "session of another number",
            "INSERT INTO checkpoint_sessions SELECT map_id, 7, content FROM checkpoint_sessions WHERE session = 1",
        ),
        ("links missing", "DELETE FROM checkpoint_links"),
        ("links elsewhere", "UPDATE checkpoint_links SET first_link = 512"),
        ("block missing", "DELETE FROM checkpoint_blocks"),
        ("block elsewhere", "UPDATE checkpoint_blocks SET first_place = 2"),
        ("block of fewer places", "UPDATE checkpoint_blocks SET places = places - 1"),
        ("block cut", "UPDATE checkpoint_blocks SET content = substr(content, 1, length(content) / 2)"),
        (
            "place of noise over its block",
            "INSERT INTO checkpoint_places SELECT map_id, 1, events, randomblob(300) FROM checkpoint_blocks",
        ),
    ];
    let stored = Stored::new().await;
    for (case, damage) in DAMAGES {
        stored.sql(damage).await;
        stored.reopens(case).await;
        // Mended: the next opening restores again.
        assert_eq!(stored.count("SELECT count(*) FROM checkpoint_places").await, 0, "{case}");
        let sealed = stored.count("SELECT sum(places) FROM checkpoint_blocks").await;
        assert_eq!(sealed, stored.places.len() as i64, "{case}");
    }
}

/// What a checkpoint consists of.
const TABLES: [&str; 5] =
    ["checkpoints", "checkpoint_sessions", "checkpoint_links", "checkpoint_blocks", "checkpoint_places"];

/// A disk that returns one wrong bit must not change what a map knows.
#[tokio::test(flavor = "multi_thread")]
async fn a_checkpoint_with_one_wrong_bit_is_replayed() {
    let stored = Stored::new().await;
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for round in 0..20 {
        // Single places are there before the first replay alone.
        let table = if round == 0 { "checkpoint_places" } else { TABLES[round % 4] };
        let column = if table == "checkpoints" { "head" } else { "content" };
        let mut database = stored.database().await;
        let select = format!(
            "SELECT rowid_, {column} FROM (SELECT {column}, row_number() OVER () AS rowid_ FROM {table})"
        );
        let rows = sqlx::query(AssertSqlSafe(select)).fetch_all(&mut database).await.unwrap();
        let row = &rows[random.random_range(0..rows.len())];
        let before: Vec<u8> = row.get(1);
        let (byte, bit) = (random.random_range(0..before.len()), random.random_range(0..8_u32));
        let mut after = before.clone();
        after[byte] ^= 1 << bit;
        let update = format!("UPDATE {table} SET {column} = ? WHERE {column} = ?");
        let done =
            sqlx::query(AssertSqlSafe(update)).bind(after).bind(before).execute(&mut database).await.unwrap();
        assert!(done.rows_affected() > 0);
        database.close().await.unwrap();
        stored.reopens(&format!("{table}.{column}, byte {byte}, bit {bit}")).await;
        stored.reopens("afterwards").await;
    }
}

/// A checkpoint and what the log has since: SIGTERM, some frames more, then `kill -9`.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_the_same_from_checkpoint_and_the_rest_of_the_log() {
    let stored = Stored::new().await;
    let server = ServerProcess::start(stored.path());
    let client = server.client().await;
    answers(&client, "drive", "first", (26..=32).map(with_odometry)).await;
    answers(&client, "drive", "third", (60..=66).map(as_words)).await;
    let hash = state_hash(&client, "drive").await;
    assert_ne!(Some(&hash), stored.map.state_hash.as_ref());
    server.kill();

    let server = ServerProcess::start(stored.path());
    assert_eq!(state_hash(&server.client().await, "drive").await, hash, "checkpoint and tail");
    server.kill();
    for table in TABLES {
        stored.clear(table).await;
    }
    let server = ServerProcess::start(stored.path());
    assert_eq!(state_hash(&server.client().await, "drive").await, hash, "full replay");
    server.stop();
}
