//! What people call places, and which frame each place began with.

use fabmap::appearance::PlaceId;
use sqlx::{Sqlite, Transaction};
use topomap::ids::FrameId;

use super::{MapId, Storage, StorageError};

/// A place with what people call it.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct LabelRow {
    #[sqlx(try_from = "u32")]
    pub(crate) place: PlaceId,
    pub(crate) label: String,
}

impl Storage {
    /// Places with labels from `from` on, by number.
    pub(crate) async fn labels(
        &self,
        map: MapId,
        from: PlaceId,
        limit: u32,
    ) -> Result<Vec<LabelRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT place, label FROM labels WHERE map_id = ? AND place >= ? ORDER BY place LIMIT ?",
        )
        .bind(map)
        .bind(from.number())
        .bind(limit)
        .fetch_all(&self.readers)
        .await?)
    }

    /// The places that bear a label, by number.
    pub(crate) async fn labelled(&self, map: MapId, label: &str) -> Result<Vec<PlaceId>, StorageError> {
        let places: Vec<u32> =
            sqlx::query_scalar("SELECT place FROM labels WHERE map_id = ? AND label = ? ORDER BY place")
                .bind(map)
                .bind(label)
                .fetch_all(&self.readers)
                .await?;
        Ok(places.into_iter().map(PlaceId::new).collect())
    }

    /// The labels that there are, each once, by name.
    pub(crate) async fn label_names(&self, map: MapId, limit: u32) -> Result<Vec<String>, StorageError> {
        Ok(sqlx::query_scalar("SELECT DISTINCT label FROM labels WHERE map_id = ? ORDER BY label LIMIT ?")
            .bind(map)
            .bind(limit)
            .fetch_all(&self.readers)
            .await?)
    }

    /// Puts one label on places, in place of what they had; all or none. [`StorageError::InUse`] if the map is gone.
    pub(crate) async fn put_labels(
        &self,
        map: MapId,
        places: &[PlaceId],
        label: &str,
    ) -> Result<(), StorageError> {
        self.check_sound(map)?;
        self.write(async |transaction| {
            for place in places {
                insert_label(transaction, map, *place, label).await?;
            }
            Ok(())
        })
        .await
    }

    /// Whether there was one.
    pub(crate) async fn delete_label(&self, map: MapId, place: PlaceId) -> Result<bool, StorageError> {
        self.check_sound(map)?;
        self.write(async |transaction| {
            let done = sqlx::query("DELETE FROM labels WHERE map_id = ? AND place = ?")
                .bind(map)
                .bind(place.number())
                .execute(&mut **transaction)
                .await?;
            Ok(done.rows_affected() > 0)
        })
        .await
    }

    /// The frame that made each place from `from` on, by place.
    pub(crate) async fn first_frames(
        &self,
        map: MapId,
        from: PlaceId,
        limit: u32,
    ) -> Result<Vec<(PlaceId, FrameId)>, StorageError> {
        let rows: Vec<(u32, FrameId)> = sqlx::query_as(
            "SELECT place, min(position) AS first FROM log WHERE map_id = ? AND place >= ? \
             GROUP BY place ORDER BY place LIMIT ?",
        )
        .bind(map)
        .bind(from.number())
        .bind(limit)
        .fetch_all(&self.readers)
        .await?;
        Ok(rows.into_iter().map(|(place, frame)| (PlaceId::new(place), frame)).collect())
    }
}

/// Puts a label on a place, in place of what it had.
pub(super) async fn insert_label(
    transaction: &mut Transaction<'_, Sqlite>,
    map: MapId,
    place: PlaceId,
    label: &str,
) -> Result<(), StorageError> {
    sqlx::query("INSERT OR REPLACE INTO labels (map_id, place, label) VALUES (?, ?, ?)")
        .bind(map)
        .bind(place.number())
        .bind(label)
        .execute(&mut **transaction)
        .await?;
    Ok(())
}
