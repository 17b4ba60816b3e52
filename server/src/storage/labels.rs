//! What people call places, and which frame each place began with.

use fabmap::appearance::PlaceId;
use sqlx::{Any, Transaction};
use topomap::ids::FrameId;

use super::values::{Whole, from_sql};
use super::{MapId, Storage, StorageError};

/// A place with what people call it.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct LabelRow {
    #[sqlx(try_from = "Whole")]
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
            "SELECT place, label FROM labels WHERE map_id = $1 AND place >= $2 ORDER BY place LIMIT $3",
        )
        .bind(map)
        .bind(i64::from(from.number()))
        .bind(i64::from(limit))
        .fetch_all(&self.readers)
        .await?)
    }

    /// The places that bear a label, by number.
    pub(crate) async fn labelled(&self, map: MapId, label: &str) -> Result<Vec<PlaceId>, StorageError> {
        let places: Vec<i64> =
            sqlx::query_scalar("SELECT place FROM labels WHERE map_id = $1 AND label = $2 ORDER BY place")
                .bind(map)
                .bind(label)
                .fetch_all(&self.readers)
                .await?;
        places.into_iter().map(|place| Ok(PlaceId::new(from_sql(place)?))).collect()
    }

    /// The labels that there are, each once, by name.
    pub(crate) async fn label_names(&self, map: MapId, limit: u32) -> Result<Vec<String>, StorageError> {
        Ok(sqlx::query_scalar("SELECT DISTINCT label FROM labels WHERE map_id = $1 ORDER BY label LIMIT $2")
            .bind(map)
            .bind(i64::from(limit))
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
            let done = sqlx::query("DELETE FROM labels WHERE map_id = $1 AND place = $2")
                .bind(map)
                .bind(i64::from(place.number()))
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
        let rows: Vec<(i64, i64)> = sqlx::query_as(
            "SELECT place, min(position) AS first FROM log WHERE map_id = $1 AND place >= $2 \
             GROUP BY place ORDER BY place LIMIT $3",
        )
        .bind(map)
        .bind(i64::from(from.number()))
        .bind(i64::from(limit))
        .fetch_all(&self.readers)
        .await?;
        rows.into_iter()
            .map(|(place, frame)| Ok((PlaceId::new(from_sql(place)?), from_sql(frame)?)))
            .collect()
    }
}

/// Puts a label on a place, in place of what it had.
pub(super) async fn insert_label(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    place: PlaceId,
    label: &str,
) -> Result<(), StorageError> {
    sqlx::query(
        "INSERT INTO labels (map_id, place, label) VALUES ($1, $2, $3) \
         ON CONFLICT (map_id, place) DO UPDATE SET label = excluded.label",
    )
    .bind(map)
    .bind(i64::from(place.number()))
    .bind(label)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
