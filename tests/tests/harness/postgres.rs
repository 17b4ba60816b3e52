//! A cluster of PostgreSQL that runs while tests do: `scripts/with-postgres`.

use std::net::SocketAddr;
use std::path::Path;

use sha2::{Digest, Sha256};
use sqlx::{AssertSqlSafe, Connection, PgConnection};
use waypost_server::config::{DataLocation, MediaAddress, StorageAddress};

/// The address of the cluster, without a database.
const POSTGRES: &str = "WAYPOST_TEST_POSTGRES";

/// Databases are made one after another: a template may be copied once at a time.
const ONE_AT_A_TIME: i64 = 7600;

/// The cluster, if one runs.
#[derive(Clone, Debug)]
pub(crate) struct Cluster {
    address: String,
}

/// A database of its own for one test.
#[derive(Clone, Debug)]
pub(crate) struct TestDatabase {
    cluster: Cluster,
    pub(crate) name: String,
}

impl Cluster {
    /// The one that runs, or `None` with a word why the test is skipped.
    pub(crate) fn running() -> Option<Self> {
        match std::env::var(POSTGRES) {
            Ok(address) => Some(Self { address }),
            Err(_) => {
                eprintln!("skipped: no PostgreSQL runs; see `make test-postgres`");
                None
            }
        }
    }

    /// Where it listens.
    pub(crate) fn socket(&self) -> SocketAddr {
        self.address.rsplit_once('@').expect("a user and a host").1.parse().expect("an address and a port")
    }

    /// Makes a database, unless it is there.
    pub(crate) async fn database(&self, name: &str) -> TestDatabase {
        self.database_with(name, "").await
    }

    /// The same, made with options.
    pub(crate) async fn database_with(&self, name: &str, options: &str) -> TestDatabase {
        let mut connection = self.connect("postgres").await;
        let lock = sqlx::query("SELECT pg_advisory_lock($1)").bind(ONE_AT_A_TIME);
        lock.execute(&mut connection).await.unwrap();
        let there = sqlx::query("SELECT 1 FROM pg_database WHERE datname = $1").bind(name);
        if there.fetch_optional(&mut connection).await.unwrap().is_none() {
            let create = format!("CREATE DATABASE {name} {options}");
            sqlx::raw_sql(AssertSqlSafe(create)).execute(&mut connection).await.unwrap();
        }
        connection.close().await.unwrap();
        TestDatabase { cluster: self.clone(), name: name.to_owned() }
    }

    async fn connect(&self, database: &str) -> PgConnection {
        PgConnection::connect(&format!("{}/{database}", self.address)).await.expect("the cluster runs")
    }
}

impl TestDatabase {
    /// As `--storage` has it.
    pub(crate) fn url(&self) -> String {
        format!("{}/{}", self.cluster.address, self.name)
    }

    /// The same, by way of something that listens there.
    pub(crate) fn url_through(&self, address: SocketAddr) -> String {
        let (user, _) = self.cluster.address.rsplit_once('@').unwrap();
        format!("{user}@{address}/{}", self.name)
    }

    pub(crate) async fn connect(&self) -> PgConnection {
        self.cluster.connect(&self.name).await
    }
}

/// Whether servers are to keep their maps there.
pub(super) fn is_asked_for() -> bool {
    std::env::var_os(POSTGRES).is_some()
}

/// The database of a directory: its file of SQLite, or one of its own where a cluster runs.
pub(crate) async fn location(directory: &Path) -> DataLocation {
    let Ok(address) = std::env::var(POSTGRES) else { return directory.into() };
    let hash = Sha256::digest(directory.as_os_str().as_encoded_bytes());
    let hash: String = hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let database = Cluster { address }.database(&format!("test_{hash}")).await;
    DataLocation {
        storage: StorageAddress::Postgres(database.url()),
        data_dir: directory.to_owned(),
        media: media_of(directory),
    }
}

/// Has servers put media into a folder beside, where it is set.
const MEDIA: &str = "WAYPOST_TEST_MEDIA";

fn media_of(directory: &Path) -> MediaAddress {
    if std::env::var_os(MEDIA).is_none() {
        return MediaAddress::Database;
    }
    let folder = directory.join("media");
    std::fs::create_dir_all(&folder).unwrap();
    MediaAddress::Folder(folder)
}
