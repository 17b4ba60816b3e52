use fabmap::appearance::PlaceId;
use sqlx::Row;

use super::{MapId, Storage, StorageError, from_sql, to_sql};

/// The fold of a map's log up to a position, as it was stored.
#[derive(Clone, Debug)]
pub(crate) struct Checkpoint {
    pub(crate) graph: Vec<u8>,
    /// Every place in order.
    pub(crate) places: Vec<Vec<u8>>,
}

impl Storage {
    /// Writes the places that changed and the graph, all or none.
    pub(crate) async fn put_checkpoint(
        &self,
        map: MapId,
        events: u64,
        graph: &[u8],
        changed: &[(PlaceId, Vec<u8>)],
    ) -> Result<(), StorageError> {
        self.write(async |transaction| {
            // Never backwards: the places of a newer checkpoint are not this one's.
            let done = sqlx::query(
                "INSERT INTO checkpoints (map_id, events, graph) VALUES (?, ?, ?) ON CONFLICT (map_id) \
                 DO UPDATE SET events = excluded.events, graph = excluded.graph WHERE excluded.events > events",
            )
            .bind(map)
            .bind(to_sql(events))
            .bind(graph)
            .execute(&mut **transaction)
            .await?;
            if done.rows_affected() == 0 {
                return Err(StorageError::Damaged("a checkpoint newer than the map in memory".to_owned()));
            }
            for (place, content) in changed {
                sqlx::query(
                    "INSERT INTO checkpoint_places (map_id, place, content) VALUES (?, ?, ?) \
                     ON CONFLICT (map_id, place) DO UPDATE SET content = excluded.content",
                )
                .bind(map)
                .bind(place)
                .bind(content)
                .execute(&mut **transaction)
                .await?;
            }
            Ok(())
        })
        .await
    }

    pub(crate) async fn checkpoint(&self, map: MapId) -> Result<Option<Checkpoint>, StorageError> {
        // One snapshot for both tables: a checkpoint may be written meanwhile.
        let mut snapshot = self.readers.begin().await?;
        let graph = sqlx::query("SELECT graph FROM checkpoints WHERE map_id = ?")
            .bind(map)
            .fetch_optional(&mut *snapshot)
            .await?;
        let Some(graph) = graph else { return Ok(None) };
        let rows =
            sqlx::query("SELECT place, content FROM checkpoint_places WHERE map_id = ? ORDER BY place")
                .bind(map)
                .fetch_all(&mut *snapshot)
                .await?;
        let mut places = Vec::with_capacity(rows.len());
        for row in rows {
            if from_sql(row.try_get("place")?)? != places.len() as u64 {
                return Err(StorageError::Damaged(format!(
                    "place {} of a checkpoint is missing",
                    places.len()
                )));
            }
            places.push(row.try_get("content")?);
        }
        Ok(Some(Checkpoint { graph: graph.try_get("graph")?, places }))
    }

    /// Forgets a checkpoint that cannot be used; the log has it all.
    pub(crate) async fn delete_checkpoint(&self, map: MapId) -> Result<(), StorageError> {
        self.write(async |transaction| {
            for delete in
                ["DELETE FROM checkpoint_places WHERE map_id = ?", "DELETE FROM checkpoints WHERE map_id = ?"]
            {
                sqlx::query(delete).bind(map).execute(&mut **transaction).await?;
            }
            Ok(())
        })
        .await
    }
}
