//! What keeps the tables, and what only one of the two can do.

use sqlx::{Any, AnyPool, Transaction};
use tokio::sync::watch;

use super::postgres::{ClusterRows, Fleet, FleetLevels, Postgres};
use super::sqlite::Sqlite;
use super::values::from_sql;
use super::{Storage, StorageError, postgres, sqlite};

/// Begins a snapshot of PostgreSQL.
pub(super) const POSTGRES_SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";

#[derive(Clone, Debug)]
pub(super) enum Engine {
    Sqlite(Sqlite),
    Postgres(Postgres),
}

impl Engine {
    /// Begins a snapshot that statements read from, whatever is written meanwhile.
    pub(super) fn begin_snapshot(&self) -> &'static str {
        match self {
            Self::Sqlite(_) => "BEGIN",
            Self::Postgres(_) => POSTGRES_SNAPSHOT,
        }
    }

    /// [`StorageError::TakenOver`] if another server owns the database by now. Inside a transaction: nobody becomes the
    /// owner before it ends.
    pub(super) async fn fence(&self, transaction: &mut Transaction<'_, Any>) -> Result<(), StorageError> {
        match self {
            // The directory's lock is held.
            Self::Sqlite(_) => Ok(()),
            Self::Postgres(postgres) => postgres.fence(transaction).await,
        }
    }

    /// [`StorageError::TakenOver`] if another server owns the database by now.
    async fn check_owned(&self, readers: &AnyPool) -> Result<(), StorageError> {
        match self {
            Self::Sqlite(_) => Ok(()),
            Self::Postgres(postgres) => postgres.check_owned(readers).await,
        }
    }

    /// Whether writers are to wait for longer than they would.
    pub(super) fn is_compacting(&self) -> bool {
        match self {
            Self::Sqlite(sqlite) => sqlite.is_compacting(),
            Self::Postgres(_) => false,
        }
    }

    /// The next number that a table gives in its column is above `last`.
    pub(super) async fn give_no_number_up_to(
        &self,
        transaction: &mut Transaction<'_, Any>,
        (table, column): (&str, &str),
        last: i64,
    ) -> Result<(), StorageError> {
        match self {
            Self::Sqlite(_) => sqlite::give_no_number_up_to(transaction, table, last).await,
            Self::Postgres(_) => postgres::give_no_number_up_to(transaction, (table, column), last).await,
        }
    }

    /// Lets another server have the database, once nothing is written any more.
    pub(super) async fn hand_over(&self, writer: &AnyPool) {
        match self {
            Self::Sqlite(_) => {}
            Self::Postgres(postgres) => postgres.hand_over(writer).await,
        }
    }

    /// Whether media may lie outside it.
    pub(super) fn may_have_objects(&self) -> bool {
        match self {
            Self::Sqlite(_) => false,
            Self::Postgres(_) => true,
        }
    }

    /// Once all connections are closed.
    pub(super) fn release(&self) {
        match self {
            Self::Sqlite(sqlite) => sqlite.release(),
            Self::Postgres(_) => {}
        }
    }
}

impl Storage {
    /// Begins a snapshot on one of a few connections.
    pub(super) async fn snapshot(&self, pool: &AnyPool) -> Result<Transaction<'static, Any>, StorageError> {
        Ok(pool.begin_with(self.engine.begin_snapshot()).await?)
    }

    /// Sees to it that what was deleted is not left between the rows; commits may wait meanwhile.
    /// [`StorageError::InUse`] if that cannot be done now.
    pub(crate) async fn wipe_deleted(&self) -> Result<(), StorageError> {
        match &self.engine {
            Engine::Sqlite(sqlite) => sqlite.wipe_deleted(&self.writer).await,
            Engine::Postgres(_) => postgres::wipe_deleted(&self.exporters).await,
        }
    }

    /// Size of the database; for SQLite without what is still in the write-ahead log.
    pub(crate) async fn size_bytes(&self) -> Result<u64, StorageError> {
        let size = match &self.engine {
            Engine::Sqlite(_) => sqlite::SIZE_BYTES,
            Engine::Postgres(_) => postgres::SIZE_BYTES,
        };
        from_sql(sqlx::query_scalar(size).fetch_one(&self.readers).await?)
    }

    /// What is left of the disk that the data directory is on, if the system tells.
    pub(crate) fn free_bytes(&self) -> Option<u64> {
        let disk = rustix::fs::statvfs(self.directory()).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    /// [`StorageError::TakenOver`] if another server owns the database by now. It is asked after the log was read and before a
    /// robot is told that a frame is there: what the next owner writes can be seen before a standby has it.
    pub(crate) async fn check_owned(&self) -> Result<(), StorageError> {
        self.engine.check_owned(&self.readers).await
    }

    /// Fails if the database does not answer.
    pub(crate) async fn ping(&self) -> Result<(), StorageError> {
        sqlx::query("SELECT 1 FROM maps LIMIT 1").fetch_optional(&self.readers).await?;
        Ok(())
    }

    /// The other servers of the same database; `None` for SQLite.
    pub(crate) fn fleet(&self) -> Option<Fleet> {
        match &self.engine {
            Engine::Sqlite(_) => None,
            Engine::Postgres(postgres) => Some(postgres.fleet()),
        }
    }

    /// What the database knows of its servers and of itself; `None` for SQLite, which has this server alone.
    pub(crate) async fn cluster(&self) -> Result<Option<ClusterRows>, StorageError> {
        match &self.engine {
            Engine::Sqlite(_) => Ok(None),
            Engine::Postgres(postgres) => Ok(Some(postgres::cluster(&self.readers, postgres.epoch()).await?)),
        }
    }

    /// How the database does that several servers have; `None` for SQLite.
    pub(crate) async fn fleet_levels(&self) -> Option<FleetLevels> {
        let Engine::Postgres(postgres) = &self.engine else { return None };
        let standbys = postgres::standbys(&self.readers).await.ok();
        let lag_bytes = standbys.iter().flatten().filter_map(|standby| standby.lag_bytes).max();
        Some(FleetLevels {
            epoch: postgres.epoch(),
            standbys: standbys.map(|standbys| standbys.len()),
            lag_bytes,
        })
    }

    /// When another server owns the database; never for SQLite.
    pub(crate) fn taken_over(&self) -> TakenOver {
        match &self.engine {
            Engine::Sqlite(_) => TakenOver(None),
            Engine::Postgres(postgres) => TakenOver(Some(postgres.taken_over())),
        }
    }
}

/// That another server owns the database, or may.
#[derive(Clone, Debug)]
pub(crate) struct TakenOver(Option<watch::Receiver<bool>>);

impl TakenOver {
    /// Completes when it happens.
    pub(crate) async fn happens(mut self) {
        let happened = match &mut self.0 {
            // Who told ends without a word where the database was handed over.
            Some(told) => told.wait_for(|happened| *happened).await.is_ok(),
            None => false,
        };
        if !happened {
            std::future::pending::<()>().await;
        }
    }

    pub(crate) fn has_happened(&self) -> bool {
        self.0.as_ref().is_some_and(|told| *told.borrow())
    }
}
