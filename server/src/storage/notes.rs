//! What robots call their frames.

use std::ops::Range;

use sqlx::{Any, Transaction};
use topomap::ids::FrameId;
use topomap::log::MapEvent;

use super::damage::{Where, gone};
use super::row_sums::StoredEvent;
use super::values::to_sql;
use super::{MapId, Storage, StorageError};

/// A frame with what its robot calls it.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct NoteRow {
    /// The frame's position in the log.
    #[sqlx(try_from = "i64")]
    pub(crate) position: FrameId,
    pub(crate) note: String,
}

/// An event with its note.
#[derive(sqlx::FromRow)]
struct NotedEvent {
    #[sqlx(flatten)]
    event: StoredEvent,
    note: String,
}

impl Storage {
    /// The event at a position of a map's log, which has it, and what its robot calls the frame; empty if nothing.
    ///
    /// # Errors
    /// [`StorageError::Rot`] if it is damaged or gone; the map is noted as such.
    pub(crate) async fn noted_event_at(
        &self,
        map: MapId,
        position: FrameId,
        vocabulary_len: usize,
    ) -> Result<(MapEvent, String), StorageError> {
        let row = sqlx::query_as(
            "SELECT position, event, checksum, chain, coalesce(note, '') AS note \
             FROM log LEFT JOIN frame_notes USING (map_id, position) WHERE map_id = $1 AND position = $2",
        )
        .bind(map)
        .bind(to_sql(position))
        .fetch_optional(&self.readers)
        .await;
        let row: Result<Option<NotedEvent>, _> = row;
        let read = row.map_err(StorageError::from).and_then(|row| {
            let NotedEvent { event, note } = row.ok_or_else(|| gone(position))?;
            Ok((event.decode(vocabulary_len)?, note))
        });
        self.noting_rot(map, Where::Event(position), read).await
    }

    /// What the frames at log positions are called; those without a note are left out.
    pub(crate) async fn notes(
        &self,
        map: MapId,
        positions: Range<u64>,
    ) -> Result<Vec<NoteRow>, StorageError> {
        let notes = sqlx::query_as(
            "SELECT position, note FROM frame_notes WHERE map_id = $1 AND position >= $2 AND position < $3 \
             ORDER BY position",
        )
        .bind(map)
        .bind(to_sql(positions.start))
        .bind(to_sql(positions.end))
        .fetch_all(&self.readers)
        .await;
        self.noting_rot(map, Where::Somewhere, notes.map_err(StorageError::from)).await
    }
}

/// Stores a note; an empty one is none.
pub(super) async fn insert_note(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    position: i64,
    note: &str,
) -> Result<(), StorageError> {
    if note.is_empty() {
        return Ok(());
    }
    sqlx::query("INSERT INTO frame_notes (map_id, position, note) VALUES ($1, $2, $3)")
        .bind(map)
        .bind(position)
        .bind(note)
        .execute(&mut **transaction)
        .await?;
    Ok(())
}

/// Gives the frames of a target, `from` positions later, the notes that those of a source have.
pub(super) async fn copy_notes(
    transaction: &mut Transaction<'_, Any>,
    source: MapId,
    map: MapId,
    positions: Range<u64>,
    from: u64,
) -> Result<(), StorageError> {
    sqlx::query(
        "INSERT INTO frame_notes (map_id, position, note) \
         SELECT $1, position + $2, note FROM frame_notes WHERE map_id = $3 AND position >= $4 AND position < $5",
    )
    .bind(map)
    .bind(to_sql(from))
    .bind(source)
    .bind(to_sql(positions.start))
    .bind(to_sql(positions.end))
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
