//! The servers of a database, and the machines that it is on, for whoever looks after them.

use sqlx::AnyPool;

use super::fitness::{FOLLOWERS, SETTINGS, doubts};
use super::lease::LEASE;
use crate::storage::StorageError;

/// What the database knows of its servers and of itself.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClusterRows {
    /// How often it has changed hands.
    pub(crate) epoch: i64,
    pub(crate) owner: ServerRow,
    /// By when they came.
    pub(crate) reserve: Vec<ServerRow>,
    pub(crate) standbys: Vec<StandbyRow>,
    /// What of its settings may lose what is acknowledged.
    pub(crate) warnings: Vec<String>,
}

/// A server, as it says itself.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct ServerRow {
    /// Its number among those that help; the epoch of the owner.
    pub(crate) id: i64,
    pub(crate) holder: String,
    pub(crate) version: String,
    pub(crate) grpc_address: String,
    pub(crate) http_address: String,
    pub(crate) cores: i64,
    /// Seconds since it last said so.
    pub(crate) silent_s: f64,
}

/// A machine that follows the one that takes writes.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct StandbyRow {
    pub(crate) name: String,
    pub(crate) state: String,
    pub(crate) sync_state: String,
    /// `None` where the database does not tell this server.
    pub(crate) lag_bytes: Option<i64>,
}

/// What of it metrics tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FleetLevels {
    pub(crate) epoch: i64,
    /// `None` if the database does not answer.
    pub(crate) standbys: Option<usize>,
    /// What the one that lacks most has not stored yet; `None` if none is seen.
    pub(crate) lag_bytes: Option<i64>,
}

/// Who is silent for longer is not listed. Another machine that took over may have a clock that is behind.
const RESERVE: &str = "SELECT id, holder, version, grpc_address, address AS http_address, cores, \
     greatest(extract(epoch FROM now() - seen)::float8, 0) AS silent_s \
     FROM helpers WHERE seen > now() - interval '1 minute' ORDER BY id";

const OWNER: &str = "SELECT epoch AS id, holder, version, grpc_address, http_address, cores, \
     greatest(extract(epoch FROM now() - expires)::float8 + $1, 0) AS silent_s FROM lease WHERE id = 1";

/// [`StorageError::TakenOver`] if the owner is no longer the one of `epoch`.
pub(in crate::storage) async fn cluster(readers: &AnyPool, epoch: i64) -> Result<ClusterRows, StorageError> {
    let owner: ServerRow = sqlx::query_as(OWNER).bind(LEASE.as_secs_f64()).fetch_one(readers).await?;
    if owner.id != epoch {
        return Err(StorageError::TakenOver);
    }
    let reserve = sqlx::query_as(RESERVE).fetch_all(readers).await?;
    let settings: Vec<(String, String)> = sqlx::query_as(SETTINGS).fetch_all(readers).await?;
    let standbys = standbys(readers).await?;
    let warnings = doubts(&settings, standbys.len());
    Ok(ClusterRows { epoch, owner, reserve, standbys, warnings })
}

/// The machines that follow the one that takes writes; not who copies it.
pub(in crate::storage) async fn standbys(readers: &AnyPool) -> Result<Vec<StandbyRow>, StorageError> {
    Ok(sqlx::query_as(FOLLOWERS).fetch_all(readers).await?)
}
