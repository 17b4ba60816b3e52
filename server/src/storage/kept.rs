//! What sessions keep, and whose they are: noted beside each session, and added up for quotas.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use sqlx::{Any, AnyConnection, Transaction};
use topomap::ids::SessionId;

use super::batches::Statements;
use super::values::{from_sql, json_list, to_sql};
use super::{MapId, Storage, StorageError};
use crate::quotas::{Quotas, Used, UsedByOwner};

/// What each session keeps of some map, counted from its log and media.
const COUNTED: &str = "SELECT session, CAST(sum(bytes) AS BIGINT) AS bytes FROM ( \
     SELECT session, length(event) AS bytes FROM log WHERE map_id = $1 \
     UNION ALL SELECT session, coalesce(object_bytes, length(content)) AS bytes FROM log JOIN frame_media USING (map_id, position) \
     WHERE map_id = $1) AS kept GROUP BY session";

/// Bytes that sessions of maps have come to keep.
pub(super) type KeptBySession = BTreeMap<(MapId, SessionId), u64>;

/// What each owner of sessions keeps.
pub(super) type KeptByOwner = Vec<(Option<String>, u64)>;

static ADD: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(3, |rows| {
        format!(
            "UPDATE sessions SET kept_bytes = kept_bytes + more.column3 FROM {rows} AS more \
             WHERE map_id = more.column1 AND number = more.column2 RETURNING owner, map_id, number"
        )
    })
});

impl Storage {
    /// The quotas, with what there is.
    pub(crate) fn quotas(&self) -> &Quotas {
        &self.quotas
    }

    /// As [`Storage::write`], for what changes whose maps and sessions there are, and what they keep.
    pub(super) async fn write_counted<T>(
        &self,
        work: impl AsyncFnOnce(&mut Transaction<'_, Any>) -> Result<T, StorageError>,
    ) -> Result<T, StorageError> {
        // Not in the same transaction: damage in some other map would undo it.
        self.write_and(work, async |connection, _| match used_by_owner(connection).await {
            Ok(used) => self.quotas.recount(used),
            Err(error) => tracing::error!(%error, "what there is for quotas could not be counted"),
        })
        .await
    }

    /// Counts what there is.
    pub(super) async fn count_used(&self) -> Result<(), StorageError> {
        self.write_counted(async |_| Ok(())).await
    }

    /// Counts what sessions keep that earlier servers stored. A map in which damage is found on the way takes nothing more, and
    /// stays as it is.
    pub(super) async fn count_old_sessions(&self) -> Result<(), StorageError> {
        let to_do = sqlx::query("SELECT 1 FROM upkeep WHERE task = 'kept_bytes'");
        if to_do.fetch_optional(&self.readers).await?.is_none() {
            return Ok(());
        }
        let maps: Vec<MapId> = sqlx::query_scalar("SELECT id FROM maps").fetch_all(&self.readers).await?;
        for map in maps {
            match self.write(async |transaction| count_sessions(transaction, map).await).await {
                Ok(()) => {}
                Err(StorageError::Rot(found)) => {
                    tracing::warn!(map, found, "what the sessions of a damaged map keep is not counted");
                }
                Err(error) => return Err(error),
            }
        }
        self.write(async |transaction| {
            let done = sqlx::query("DELETE FROM upkeep WHERE task = 'kept_bytes'");
            done.execute(&mut **transaction).await?;
            Ok(())
        })
        .await
    }
}

/// Counts what the sessions of a map keep, and notes it.
pub(super) async fn count_sessions(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
) -> Result<(), StorageError> {
    let count = format!(
        "UPDATE sessions SET kept_bytes = counted.bytes FROM ({COUNTED}) AS counted \
         WHERE sessions.map_id = $1 AND sessions.number = counted.session"
    );
    sqlx::query(sqlx::AssertSqlSafe(count)).bind(map).execute(&mut **transaction).await?;
    Ok(())
}

/// The sessions of a map of which another number is noted than is counted: name, noted, counted.
pub(super) fn wrongly_noted() -> String {
    format!(
        "SELECT name, kept_bytes, coalesce(counted.bytes, 0) FROM sessions \
         LEFT JOIN ({COUNTED}) AS counted ON counted.session = sessions.number \
         WHERE sessions.map_id = $1 AND kept_bytes != coalesce(counted.bytes, 0) ORDER BY number"
    )
}

/// Notes what sessions have come to keep; what that is by owner.
pub(super) async fn add_kept(
    transaction: &mut Transaction<'_, Any>,
    kept: &KeptBySession,
) -> Result<KeptByOwner, StorageError> {
    let mut by_owner = KeptByOwner::with_capacity(kept.len());
    let mut left = kept.iter();
    while left.len() > 0 {
        let (statement, rows) = ADD.for_first(left.len());
        let mut query = sqlx::query_as(statement);
        for ((map, session), bytes) in left.by_ref().take(rows) {
            query = query.bind(*map).bind(i64::from(*session)).bind(to_sql(*bytes));
        }
        let updated: Vec<(Option<String>, MapId, i64)> = query.fetch_all(&mut **transaction).await?;
        for (owner, map, session) in updated {
            let bytes = kept.get(&(map, from_sql(session)?)).copied().unwrap_or_default();
            by_owner.push((owner, bytes));
        }
    }
    Ok(by_owner)
}

/// How many sessions some maps have, and what they keep.
pub(super) async fn kept_by_maps(
    transaction: &mut Transaction<'_, Any>,
    maps: &[MapId],
) -> Result<(u64, u64), StorageError> {
    let (sessions, kept_bytes) = sqlx::query_as(
        "SELECT count(*), CAST(coalesce(sum(kept_bytes), 0) AS BIGINT) FROM sessions \
         WHERE map_id IN (SELECT value FROM json_each($1))",
    )
    .bind(json_list(maps.iter().copied()))
    .fetch_one(&mut **transaction)
    .await?;
    Ok((from_sql(sessions)?, from_sql(kept_bytes)?))
}

/// What there is by owner. What is being deleted is gone; what is being brought in is there.
async fn used_by_owner(connection: &mut AnyConnection) -> Result<UsedByOwner, StorageError> {
    let mut by_owner = UsedByOwner::new();
    let sessions: Vec<(Option<String>, i64, i64)> = sqlx::query_as(
        "SELECT sessions.owner, count(*), CAST(sum(kept_bytes) AS BIGINT) FROM sessions JOIN maps ON maps.id = sessions.map_id \
         WHERE maps.state != 'deleting' GROUP BY sessions.owner",
    )
    .fetch_all(&mut *connection)
    .await?;
    for (owner, sessions, kept_bytes) in sessions {
        let (sessions, kept_bytes) = (from_sql(sessions)?, from_sql(kept_bytes)?);
        by_owner.insert(owner, Used { maps: 0, sessions, kept_bytes });
    }
    let maps: Vec<(Option<String>, i64)> =
        sqlx::query_as("SELECT owner, count(*) FROM maps WHERE state != 'deleting' GROUP BY owner")
            .fetch_all(&mut *connection)
            .await?;
    for (owner, maps) in maps {
        by_owner.entry(owner).or_default().maps = from_sql(maps)?;
    }
    Ok(by_owner)
}
