use std::ops::Range;

use fabmap::appearance::PlaceId;
use sqlx::{Any, Transaction};
use topomap::checkpoint::{Block, Pieces};
use topomap::ids::SessionId;

use super::values::{Whole, from_sql, to_sql};
use super::{MapId, Storage, StorageError, delete_some};

/// Tables of a checkpoint without its head, their keys, and how many rows are deleted at a time.
pub(super) const CHECKPOINT_PIECES: [(&str, &str, u32); 4] = [
    ("checkpoint_places", "place", 500),
    ("checkpoint_blocks", "first_place", 8),
    ("checkpoint_links", "first_link", 100),
    ("checkpoint_sessions", "session", 500),
];

/// One consistent view of a map's checkpoint, whatever is written meanwhile. Holds one of a few connections.
#[derive(Debug)]
pub(crate) struct CheckpointView {
    map: MapId,
    /// The fold of the log up to here.
    pub(crate) events: u64,
    pub(crate) head: Vec<u8>,
    snapshot: Transaction<'static, Any>,
}

/// A sealed block as it was stored.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct StoredBlock {
    #[sqlx(rename = "first_place", try_from = "Whole")]
    pub(crate) first: PlaceId,
    #[sqlx(try_from = "i64")]
    pub(crate) places: u32,
    /// As of this log position.
    #[sqlx(try_from = "i64")]
    events: u64,
    pub(crate) content: Vec<u8>,
}

impl StoredBlock {
    pub(crate) fn range(&self) -> Range<PlaceId> {
        self.first..PlaceId::new(self.first.number().saturating_add(self.places))
    }
}

impl Storage {
    /// Writes the pieces that changed, all or none.
    pub(crate) async fn put_checkpoint(&self, map: MapId, pieces: &Pieces) -> Result<(), StorageError> {
        let Pieces { events, head, sessions, links, places } = pieces;
        self.write(async |transaction| {
            // Never backwards: the pieces of a newer checkpoint are not this one's.
            let done = sqlx::query(
                "INSERT INTO checkpoints (map_id, events, head) VALUES ($1, $2, $3) ON CONFLICT (map_id) \
                 DO UPDATE SET events = excluded.events, head = excluded.head WHERE excluded.events > checkpoints.events",
            )
            .bind(map)
            .bind(to_sql(*events))
            .bind(head)
            .execute(&mut **transaction)
            .await?;
            if done.rows_affected() == 0 {
                return Err(StorageError::Damaged("a checkpoint newer than the map in memory".to_owned()));
            }
            for (session, content) in sessions {
                sqlx::query(
                    "INSERT INTO checkpoint_sessions (map_id, session, content) VALUES ($1, $2, $3) \
                     ON CONFLICT (map_id, session) DO UPDATE SET content = excluded.content",
                )
                .bind(map)
                .bind(i64::from(*session))
                .bind(content)
                .execute(&mut **transaction)
                .await?;
            }
            for (first_link, content) in links {
                sqlx::query(
                    "INSERT INTO checkpoint_links (map_id, first_link, content) VALUES ($1, $2, $3) \
                     ON CONFLICT (map_id, first_link) DO UPDATE SET content = excluded.content",
                )
                .bind(map)
                .bind(to_sql(*first_link))
                .bind(content)
                .execute(&mut **transaction)
                .await?;
            }
            for (place, content) in places {
                sqlx::query(
                    "INSERT INTO checkpoint_places (map_id, place, events, content) VALUES ($1, $2, $3, $4) \
                     ON CONFLICT (map_id, place) DO UPDATE SET events = excluded.events, content = excluded.content",
                )
                .bind(map)
                .bind(i64::from(place.number()))
                .bind(to_sql(*events))
                .bind(content)
                .execute(&mut **transaction)
                .await?;
            }
            Ok(())
        })
        .await
    }

    /// Writes a block of a checkpoint that has no head yet: until it has one, nobody sees it.
    pub(crate) async fn put_block(&self, map: MapId, events: u64, block: &Block) -> Result<(), StorageError> {
        self.write(async |transaction| insert_block(transaction, map, events, block).await).await
    }

    /// Puts `sealed` where `before` was, or behind the last block if there was none: the places as of log position
    /// `events`. Places that have changed since then keep their rows.
    ///
    /// [`StorageError::Exists`] or [`StorageError::Damaged`] if what is stored is not `before`; nothing changes then.
    pub(crate) async fn seal(
        &self,
        map: MapId,
        events: u64,
        before: Option<&StoredBlock>,
        sealed: &[Block],
    ) -> Result<(), StorageError> {
        self.write(async |transaction| {
            if let Some(before) = before {
                let done = sqlx::query(
                    "DELETE FROM checkpoint_blocks WHERE map_id = $1 AND first_place = $2 AND events = $3",
                )
                .bind(map)
                .bind(i64::from(before.first.number()))
                .bind(to_sql(before.events))
                .execute(&mut **transaction)
                .await?;
                if done.rows_affected() == 0 {
                    return Err(StorageError::Damaged("a block of a checkpoint is another by now".to_owned()));
                }
            }
            for block in sealed {
                insert_block(transaction, map, events, block).await?;
                sqlx::query(
                    "DELETE FROM checkpoint_places WHERE map_id = $1 AND place >= $2 AND place < $3 AND events <= $4",
                )
                .bind(map)
                .bind(i64::from(block.first.number()))
                .bind(i64::from(PlaceId::new(block.places).counted_from(block.first).number()))
                .bind(to_sql(events))
                .execute(&mut **transaction)
                .await?;
            }
            Ok(())
        })
        .await
    }

    /// A view of a map's checkpoint as it is now; `None` if there is none.
    pub(crate) async fn view_checkpoint(&self, map: MapId) -> Result<Option<CheckpointView>, StorageError> {
        let mut snapshot = self.snapshot(&self.readers).await?;
        let head = sqlx::query_as("SELECT events, head FROM checkpoints WHERE map_id = $1")
            .bind(map)
            .fetch_optional(&mut *snapshot)
            .await?;
        let Some((events, head)) = head else { return Ok(None) };
        Ok(Some(CheckpointView { map, events: from_sql(events)?, head, snapshot }))
    }

    /// Forgets a checkpoint that cannot be used; the log has it all.
    pub(crate) async fn delete_checkpoint(&self, map: MapId) -> Result<(), StorageError> {
        // The head first: without it the rest is nothing, however far the deleting comes.
        self.write(async |transaction| {
            sqlx::query("DELETE FROM checkpoints WHERE map_id = $1")
                .bind(map)
                .execute(&mut **transaction)
                .await?;
            Ok(())
        })
        .await?;
        for table in CHECKPOINT_PIECES {
            while self.write(async |transaction| delete_some(transaction, map, table).await).await? > 0 {}
        }
        Ok(())
    }
}

impl CheckpointView {
    /// Every session.
    pub(crate) async fn sessions(&mut self) -> Result<Vec<(SessionId, Vec<u8>)>, StorageError> {
        let rows = sqlx::query_as("SELECT session, content FROM checkpoint_sessions WHERE map_id = $1")
            .bind(self.map)
            .fetch_all(&mut *self.snapshot)
            .await?;
        keyed(rows)
    }

    /// All links in order, by the number of the first of each piece.
    pub(crate) async fn links(&mut self) -> Result<Vec<(u64, Vec<u8>)>, StorageError> {
        let rows = sqlx::query_as(
            "SELECT first_link, content FROM checkpoint_links WHERE map_id = $1 ORDER BY first_link",
        )
        .bind(self.map)
        .fetch_all(&mut *self.snapshot)
        .await?;
        keyed(rows)
    }

    /// The places of `places` that hold over their blocks, or are in none; ascending.
    pub(crate) async fn places(
        &mut self,
        places: Range<PlaceId>,
    ) -> Result<Vec<(PlaceId, Vec<u8>)>, StorageError> {
        let rows = sqlx::query_as(
            "SELECT place, content FROM checkpoint_places WHERE map_id = $1 AND place >= $2 AND place < $3 ORDER BY place",
        )
        .bind(self.map)
        .bind(i64::from(places.start.number()))
        .bind(i64::from(places.end.number()))
        .fetch_all(&mut *self.snapshot)
        .await?;
        Ok(keyed(rows)?.into_iter().map(|(place, content)| (PlaceId::new(place), content)).collect())
    }

    /// Up to `limit` blocks of places from `from` on, in order.
    pub(crate) async fn blocks(
        &mut self,
        from: PlaceId,
        limit: u32,
    ) -> Result<Vec<StoredBlock>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT first_place, places, events, content FROM checkpoint_blocks \
             WHERE map_id = $1 AND first_place >= $2 ORDER BY first_place LIMIT $3",
        )
        .bind(self.map)
        .bind(i64::from(from.number()))
        .bind(i64::from(limit))
        .fetch_all(&mut *self.snapshot)
        .await?)
    }
}

/// Rows by their keys, which are numbers.
fn keyed<K: TryFrom<i64>>(rows: Vec<(i64, Vec<u8>)>) -> Result<Vec<(K, Vec<u8>)>, StorageError> {
    rows.into_iter().map(|(key, content)| Ok((from_sql(key)?, content))).collect()
}

async fn insert_block(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    events: u64,
    block: &Block,
) -> Result<(), StorageError> {
    let Block { first, places, bytes } = block;
    sqlx::query(
        "INSERT INTO checkpoint_blocks (map_id, first_place, places, events, content) VALUES ($1, $2, $3, $4, $5)",
    )
    .bind(map)
    .bind(i64::from(first.number()))
    .bind(i64::from(*places))
    .bind(to_sql(events))
    .bind(bytes)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
