//! What people said of loop closures.

use topomap::log::{CorrectionEvent, FrameEvent, MapEvent};

use super::log::as_frame;
use super::values::to_sql;
use super::{MapId, Storage, StorageError};

impl Storage {
    /// All that people said of a map's loop closures, undone or not, in the order of the log.
    pub(crate) async fn corrections(&self, map: MapId) -> Result<Vec<CorrectionEvent>, StorageError> {
        // As its index says it.
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log \
             WHERE map_id = $1 AND sequence IS NULL AND reason IS NOT NULL ORDER BY position",
        )
        .bind(map)
        .fetch_all(&self.readers)
        .await;
        let correction = |event| match event {
            MapEvent::Corrected(event) => Some(*event),
            MapEvent::SessionOpened { .. } | MapEvent::Frame(_) | MapEvent::Measured(_) => None,
        };
        // They have no words, of whatever vocabulary.
        Ok(self.decoded(map, stored, 0).await?.into_iter().filter_map(correction).collect())
    }

    /// Up to `most` frames that a session sent before another, latest first.
    pub(crate) async fn frames_before(
        &self,
        map: MapId,
        frame: &FrameEvent,
        most: u32,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameEvent>, StorageError> {
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND session = $2 AND sequence < $3 \
             ORDER BY sequence DESC LIMIT $4",
        )
        .bind(map)
        .bind(i64::from(frame.session))
        .bind(to_sql(frame.sequence))
        .bind(i64::from(most))
        .fetch_all(&self.readers)
        .await;
        Ok(self.decoded(map, stored, vocabulary_len).await?.into_iter().filter_map(as_frame).collect())
    }

    /// Up to `most` frames that a session sent after another, in their order.
    pub(crate) async fn frames_after(
        &self,
        map: MapId,
        frame: &FrameEvent,
        most: u32,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameEvent>, StorageError> {
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND session = $2 AND sequence > $3 \
             ORDER BY sequence LIMIT $4",
        )
        .bind(map)
        .bind(i64::from(frame.session))
        .bind(to_sql(frame.sequence))
        .bind(i64::from(most))
        .fetch_all(&self.readers)
        .await;
        Ok(self.decoded(map, stored, vocabulary_len).await?.into_iter().filter_map(as_frame).collect())
    }
}
