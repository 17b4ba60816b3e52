//! Servers that do not own the database, as the owner finds them.

use std::time::{Duration, Instant};

use sqlx::{AnyPool, Connection};

use super::machines::{Machines, Primary};
use super::this_server::{Addresses, VERSION, cores};
use crate::storage::StorageError;

/// How often a helper says that it is there.
const INTERVAL: Duration = Duration::from_secs(1);

/// A server that looks at images for the owner.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct HelperRow {
    pub(crate) id: i64,
    /// For people.
    pub(crate) holder: String,
    /// Host and port.
    pub(crate) address: String,
    /// Images that it looks at side by side.
    pub(crate) cores: i64,
}

/// Of this server, among those that help.
pub(super) struct Registration {
    /// Empty if it is not asked anything.
    addresses: Addresses,
    holder: String,
    id: Option<i64>,
    renewed: Option<Instant>,
}

impl Registration {
    /// `holder`, asked at `addresses`.
    pub(super) fn new(holder: String, addresses: Addresses) -> Self {
        Self { addresses, holder, id: None, renewed: None }
    }

    /// Says that this server is there, now and then.
    pub(super) async fn renew(&mut self, pool: &AnyPool) -> Result<(), StorageError> {
        let is_early = self.renewed.is_some_and(|at| at.elapsed() < INTERVAL);
        let Addresses { grpc, http } = &self.addresses;
        if http.is_empty() || is_early {
            return Ok(());
        }
        self.renewed = Some(Instant::now());
        if let Some(id) = self.id {
            let renewed =
                sqlx::query("UPDATE helpers SET seen = now() WHERE id = $1").bind(id).execute(pool).await?;
            if renewed.rows_affected() == 1 {
                return Ok(());
            }
        }
        // Before it lost sight of the database, or was started anew, it was there under another number.
        sqlx::query("DELETE FROM helpers WHERE address = $1").bind(http).execute(pool).await?;
        let inserted = sqlx::query_scalar(
            "INSERT INTO helpers (holder, version, address, grpc_address, cores, seen) \
             VALUES ($1, $2, $3, $4, $5, now()) RETURNING id",
        );
        let inserted = inserted.bind(&self.holder).bind(VERSION).bind(http).bind(grpc).bind(cores() as i64);
        self.id = Some(inserted.fetch_one(pool).await?);
        Ok(())
    }

    /// It helps no more, since it owns the database. Those that have gone without a word are forgotten.
    pub(super) async fn withdraw(&mut self, pool: &AnyPool) -> Result<(), StorageError> {
        let gone = "DELETE FROM helpers WHERE address = $1 OR seen < now() - interval '1 minute'";
        sqlx::query(gone).bind(&self.addresses.http).execute(pool).await?;
        Ok(())
    }
}

/// Those of this version that were there just now.
pub(super) async fn who_helps(pool: &AnyPool) -> Result<Vec<HelperRow>, StorageError> {
    let rows = sqlx::query_as(
        "SELECT id, holder, address, cores FROM helpers \
         WHERE version = $1 AND seen > now() - interval '3 seconds' ORDER BY id",
    );
    Ok(rows.bind(VERSION).fetch_all(pool).await?)
}

/// The file of a model, read by a server that does not own the database at `address`. [`StorageError::DamagedModel`] if it is
/// not as it was written.
pub(crate) async fn model_file(address: &str, hash: &str) -> Result<Option<Vec<u8>>, StorageError> {
    let machines = Machines::of(address).map_err(StorageError::Unfit)?;
    let Primary { mut connection, address: _ } = machines.primary().await?;
    let file = sqlx::query_scalar("SELECT file FROM models WHERE hash = $1");
    let file = file.bind(hash).fetch_optional(&mut connection).await;
    let file = file.map_err(|error| StorageError::of_model(hash, error))?;
    connection.close().await?;
    Ok(file)
}
