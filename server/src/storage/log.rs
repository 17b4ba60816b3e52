use std::collections::HashMap;
use std::ops::Range;

use fabmap::appearance::PlaceId;
use topomap::ids::{FrameId, SessionId};
use topomap::log::{FrameEvent, MapEvent, MeasuredEvent};

use super::damage::Where;
use super::row_sums::{CHAIN_START, StoredEvent};
use super::values::{from_sql, json_list, to_sql};
use super::{MapId, Medium, Storage, StorageError};

/// Events read at a time when a log is replayed.
const REPLAY_PAGE: u32 = 1000;

/// One row of a map's log, and what is kept beside it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LogEntry {
    pub(crate) position: u64,
    pub(crate) event: MapEvent,
    /// Written with the event, and read apart from it.
    pub(crate) media: Vec<Medium>,
    /// What the robot calls the frame; empty if nothing.
    pub(crate) note: String,
}

/// Which frame a log position is.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct StoredFrame {
    #[sqlx(try_from = "i64")]
    pub(crate) session: SessionId,
    #[sqlx(try_from = "i64")]
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    /// What its robot calls it; empty if nothing.
    pub(crate) note: String,
}

/// The same, with its position.
#[derive(sqlx::FromRow)]
struct FrameAt {
    #[sqlx(try_from = "i64")]
    position: FrameId,
    #[sqlx(flatten)]
    frame: StoredFrame,
}

/// A loop closure as the log's columns tell it.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct ClosureRow {
    #[sqlx(try_from = "i64")]
    pub(crate) position: u64,
    #[sqlx(flatten)]
    pub(crate) frame: StoredFrame,
    #[sqlx(flatten, try_from = "MatchedColumns")]
    pub(crate) matched: StoredFrame,
    #[sqlx(try_from = "i64")]
    pub(crate) place: u32,
    pub(crate) posterior: f64,
    pub(crate) probability: Option<f64>,
}

/// The frame that another matched, beside that other.
#[derive(sqlx::FromRow)]
struct MatchedColumns {
    #[sqlx(try_from = "i64")]
    matched_session: SessionId,
    #[sqlx(try_from = "i64")]
    matched_sequence: u64,
    matched_stamp_ns: i64,
    matched_note: String,
}

impl From<MatchedColumns> for StoredFrame {
    fn from(matched: MatchedColumns) -> Self {
        let MatchedColumns { matched_session, matched_sequence, matched_stamp_ns, matched_note } = matched;
        Self {
            session: matched_session,
            sequence: matched_sequence,
            stamp_ns: matched_stamp_ns,
            note: matched_note,
        }
    }
}

impl Storage {
    /// Hands the events at `positions` to `fold`, in order, without what is kept beside them.
    pub(crate) async fn replay(
        &self,
        map: MapId,
        positions: Range<u64>,
        vocabulary_len: usize,
        fold: &mut (dyn FnMut(u64, MapEvent) -> Result<(), StorageError> + Send),
    ) -> Result<(), StorageError> {
        let edition = self.map_of_id(map).await?.map(|row| row.edition);
        let mut next = positions.start;
        let mut chain = self.chain_before(map, next).await?;
        // Page by page, so that a long replay does not keep a connection from others.
        loop {
            let rows = self.stored_events(map, next..positions.end).await;
            let rows = self.noting_rot(map, Where::Somewhere, rows).await?;
            // What follows on what was read before, if that is still so.
            if self.map_of_id(map).await?.map(|row| row.edition) != edition {
                return Err(StorageError::Retold);
            }
            let last = rows.len() < REPLAY_PAGE as usize;
            for stored in rows {
                let event = stored.follow(next, chain).and_then(|link| {
                    chain = link;
                    stored.decode(vocabulary_len)
                });
                fold(next, self.noting_rot(map, Where::Event(next), event).await?)?;
                next += 1;
            }
            if last {
                return Ok(());
            }
        }
    }

    /// The link of the event before `position` in the log's chain.
    async fn chain_before(&self, map: MapId, position: u64) -> Result<i64, StorageError> {
        let Some(before) = position.checked_sub(1) else { return Ok(CHAIN_START) };
        let stored = self.stored_events(map, before..position).await;
        let stored = self.noting_rot(map, Where::Event(before), stored).await?;
        let chain = match stored.first() {
            Some(stored) => stored.check().map(|()| stored.chain()),
            // The log may be shorter than a checkpoint that was damaged says.
            None => Ok(CHAIN_START),
        };
        self.noting_rot(map, Where::Event(before), chain).await
    }

    /// The first events at `positions`.
    pub(super) async fn stored_events(
        &self,
        map: MapId,
        positions: Range<u64>,
    ) -> Result<Vec<StoredEvent>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND position >= $2 AND position < $3 \
             ORDER BY position LIMIT $4",
        )
        .bind(map)
        .bind(to_sql(positions.start))
        .bind(to_sql(positions.end))
        .bind(i64::from(REPLAY_PAGE))
        .fetch_all(&self.readers)
        .await?)
    }

    /// The event at a position of a map's log.
    pub(crate) async fn event_at(
        &self,
        map: MapId,
        position: FrameId,
        vocabulary_len: usize,
    ) -> Result<Option<MapEvent>, StorageError> {
        let select = "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND position = $2";
        let stored = sqlx::query_as(select).bind(map).bind(to_sql(position)).fetch_all(&self.readers).await;
        Ok(self.decoded(map, stored, vocabulary_len).await?.pop())
    }

    /// The frame that a session sent under `sequence`, if it is durable. [`StorageError::TakenOver`] if another server may have
    /// written it.
    pub(crate) async fn event_of_sequence(
        &self,
        map: MapId,
        session: SessionId,
        sequence: u64,
        vocabulary_len: usize,
    ) -> Result<Option<MapEvent>, StorageError> {
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND session = $2 AND sequence = $3",
        )
        .bind(map)
        .bind(i64::from(session))
        .bind(to_sql(sequence))
        .fetch_all(&self.readers)
        .await;
        let stored = self.decoded(map, stored, vocabulary_len).await?.pop();
        self.check_owned().await?;
        Ok(stored)
    }

    /// The frame that a session sent before another.
    pub(crate) async fn frame_before(
        &self,
        map: MapId,
        frame: &FrameEvent,
        vocabulary_len: usize,
    ) -> Result<Option<FrameEvent>, StorageError> {
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND session = $2 AND sequence < $3 \
             ORDER BY sequence DESC LIMIT 1",
        )
        .bind(map)
        .bind(i64::from(frame.session))
        .bind(to_sql(frame.sequence))
        .fetch_all(&self.readers)
        .await;
        Ok(self.decoded(map, stored, vocabulary_len).await?.pop().and_then(as_frame))
    }

    /// The last frames of a session, latest first.
    pub(crate) async fn last_frames(
        &self,
        map: MapId,
        session: SessionId,
        most: usize,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameEvent>, StorageError> {
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND session = $2 \
             AND sequence IS NOT NULL ORDER BY sequence DESC LIMIT $3",
        )
        .bind(map)
        .bind(i64::from(session))
        .bind(to_sql(most as u64))
        .fetch_all(&self.readers)
        .await;
        Ok(self.decoded(map, stored, vocabulary_len).await?.into_iter().filter_map(as_frame).collect())
    }

    /// What robots measured at frames of a session, oldest first.
    pub(crate) async fn measured_of_session(
        &self,
        map: MapId,
        session: SessionId,
        vocabulary_len: usize,
    ) -> Result<Vec<MeasuredEvent>, StorageError> {
        let stored = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND session = $2 AND sequence IS NULL \
             ORDER BY position",
        )
        .bind(map)
        .bind(i64::from(session))
        .fetch_all(&self.readers)
        .await;
        let measured = |event| match event {
            MapEvent::Measured(event) => Some(*event),
            MapEvent::SessionOpened { .. } | MapEvent::Frame(_) | MapEvent::Corrected(_) => None,
        };
        Ok(self.decoded(map, stored, vocabulary_len).await?.into_iter().filter_map(measured).collect())
    }

    /// Events that were read of a map's log.
    pub(super) async fn decoded(
        &self,
        map: MapId,
        stored: Result<Vec<StoredEvent>, sqlx::Error>,
        vocabulary_len: usize,
    ) -> Result<Vec<MapEvent>, StorageError> {
        let stored = self.noting_rot(map, Where::Somewhere, stored.map_err(StorageError::from)).await?;
        let mut events = Vec::with_capacity(stored.len());
        for stored in stored {
            let event = stored.decode(vocabulary_len);
            events.push(self.noting_rot(map, Where::Event(stored.position), event).await?);
        }
        Ok(events)
    }

    /// The latest frames of a place that came in before `before`, latest first.
    pub(crate) async fn frames_of_place(
        &self,
        map: MapId,
        place: PlaceId,
        before: FrameId,
        limit: u32,
    ) -> Result<Vec<FrameId>, StorageError> {
        let frames: Result<Vec<i64>, _> = sqlx::query_scalar(
            "SELECT position FROM log WHERE map_id = $1 AND place = $2 AND position < $3 ORDER BY position DESC LIMIT $4",
        )
        .bind(map)
        .bind(i64::from(place.number()))
        .bind(to_sql(before))
        .bind(i64::from(limit))
        .fetch_all(&self.readers)
        .await;
        let frames = self.noting_rot(map, Where::Somewhere, frames.map_err(StorageError::from)).await?;
        frames.into_iter().map(from_sql).collect()
    }

    /// Which session and sequence number the frames at these positions have, in the same order;
    /// positions that are not frames are left out.
    pub(crate) async fn frames_at(
        &self,
        map: MapId,
        positions: &[FrameId],
    ) -> Result<Vec<StoredFrame>, StorageError> {
        let found = self.frames_by_position(map, positions.iter().copied()).await?;
        Ok(positions.iter().filter_map(|position| found.get(position).cloned()).collect())
    }

    /// The same, each with its position: many cost one query.
    pub(crate) async fn frames_by_position(
        &self,
        map: MapId,
        positions: impl IntoIterator<Item = FrameId>,
    ) -> Result<HashMap<FrameId, StoredFrame>, StorageError> {
        let positions = json_list(positions.into_iter().map(to_sql));
        let rows = sqlx::query_as(
            "SELECT position, session, sequence, stamp_ns, coalesce(note, '') AS note \
             FROM log LEFT JOIN frame_notes USING (map_id, position) \
             WHERE map_id = $1 AND sequence IS NOT NULL AND position IN (SELECT value FROM json_each($2))",
        )
        .bind(map)
        .bind(positions)
        .fetch_all(&self.readers)
        .await;
        let rows: Vec<FrameAt> =
            self.noting_rot(map, Where::Somewhere, rows.map_err(StorageError::from)).await?;
        Ok(rows.into_iter().map(|FrameAt { position, frame }| (position, frame)).collect())
    }

    /// Loop closures after log position `after` (all if `None`), oldest first.
    pub(crate) async fn loop_closures(
        &self,
        map: MapId,
        after: Option<u64>,
        limit: u32,
    ) -> Result<Vec<ClosureRow>, StorageError> {
        let closures = sqlx::query_as(
            "SELECT f.position, f.session, f.sequence, f.stamp_ns, f.place, f.posterior, f.probability, \
             m.session AS matched_session, m.sequence AS matched_sequence, m.stamp_ns AS matched_stamp_ns, \
             coalesce(fn.note, '') AS note, coalesce(mn.note, '') AS matched_note \
             FROM log AS f JOIN log AS m ON m.map_id = f.map_id AND m.position = f.matched_frame \
             LEFT JOIN frame_notes AS fn ON fn.map_id = f.map_id AND fn.position = f.position \
             LEFT JOIN frame_notes AS mn ON mn.map_id = m.map_id AND mn.position = m.position \
             WHERE f.map_id = $1 AND f.reason = 'loop_closure' AND f.position > $2 ORDER BY f.position LIMIT $3",
        )
        .bind(map)
        .bind(after.map_or(-1, to_sql))
        .bind(i64::from(limit))
        .fetch_all(&self.readers)
        .await;
        self.noting_rot(map, Where::Somewhere, closures.map_err(StorageError::from)).await
    }
}

pub(super) fn as_frame(event: MapEvent) -> Option<FrameEvent> {
    match event {
        MapEvent::Frame(frame) => Some(*frame),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    }
}
