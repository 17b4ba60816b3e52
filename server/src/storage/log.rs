use std::collections::HashMap;
use std::ops::Range;

use fabmap::appearance::PlaceId;
use sqlx::{Sqlite, Transaction};
use topomap::evidence::Candidate;
use topomap::ids::{FrameId, SessionId};
use topomap::log::{FrameEvent, Link, MapEvent, MeasuredEvent, Reason};

use super::media::insert_media;
use super::notes::insert_note;
use super::{MapId, Medium, Storage, StorageError, to_sql};

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
    pub(crate) session: SessionId,
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    /// What its robot calls it; empty if nothing.
    pub(crate) note: String,
}

/// A loop closure as the log's columns tell it.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct ClosureRow {
    pub(crate) position: u64,
    #[sqlx(flatten)]
    pub(crate) frame: StoredFrame,
    #[sqlx(flatten, try_from = "MatchedColumns")]
    pub(crate) matched: StoredFrame,
    pub(crate) place: u32,
    pub(crate) posterior: f64,
    pub(crate) probability: Option<f64>,
}

/// The frame that another matched, beside that other.
#[derive(sqlx::FromRow)]
struct MatchedColumns {
    matched_session: SessionId,
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
    /// Appends events to a map's log, all or none, and returns when they are on the disk.
    pub(crate) async fn append(&self, map: MapId, entries: &[LogEntry]) -> Result<(), StorageError> {
        self.write(async |transaction| {
            for LogEntry { position, event, media, note } in entries {
                insert_event(transaction, map, to_sql(*position), event).await?;
                insert_media(transaction, map, to_sql(*position), media).await?;
                insert_note(transaction, map, to_sql(*position), note).await?;
            }
            Ok(())
        })
        .await?;
        self.commits.tell(map);
        Ok(())
    }

    /// Hands the events at `positions` to `fold`, in order, without what is kept beside them.
    pub(crate) async fn replay(
        &self,
        map: MapId,
        positions: Range<u64>,
        vocabulary_len: usize,
        fold: &mut (dyn FnMut(u64, MapEvent) -> Result<(), StorageError> + Send),
    ) -> Result<(), StorageError> {
        // Page by page, so that a long replay does not keep a connection from others.
        let mut next = to_sql(positions.start);
        let end = to_sql(positions.end);
        loop {
            let rows: Vec<(u64, Vec<u8>)> = sqlx::query_as(
                "SELECT position, event FROM log WHERE map_id = ? AND position >= ? AND position < ? ORDER BY position LIMIT ?",
            )
            .bind(map)
            .bind(next)
            .bind(end)
            .bind(REPLAY_PAGE)
            .fetch_all(&self.readers)
            .await?;
            let last = rows.len() < REPLAY_PAGE as usize;
            for (position, bytes) in rows {
                fold(position, event(&bytes, vocabulary_len)?)?;
                next = to_sql(position) + 1;
            }
            if last {
                return Ok(());
            }
        }
    }

    /// The event at a position of a map's log.
    pub(crate) async fn event_at(
        &self,
        map: MapId,
        position: FrameId,
        vocabulary_len: usize,
    ) -> Result<Option<MapEvent>, StorageError> {
        let bytes: Option<Vec<u8>> =
            sqlx::query_scalar("SELECT event FROM log WHERE map_id = ? AND position = ?")
                .bind(map)
                .bind(to_sql(position))
                .fetch_optional(&self.readers)
                .await?;
        bytes.map(|bytes| event(&bytes, vocabulary_len)).transpose()
    }

    /// The same with what its robot calls the frame; empty if nothing.
    pub(crate) async fn noted_event_at(
        &self,
        map: MapId,
        position: FrameId,
        vocabulary_len: usize,
    ) -> Result<Option<(MapEvent, String)>, StorageError> {
        let row: Option<(Vec<u8>, String)> = sqlx::query_as(
            "SELECT event, coalesce(note, '') FROM log LEFT JOIN frame_notes USING (map_id, position) \
             WHERE map_id = ? AND position = ?",
        )
        .bind(map)
        .bind(to_sql(position))
        .fetch_optional(&self.readers)
        .await?;
        row.map(|(bytes, note)| Ok((event(&bytes, vocabulary_len)?, note))).transpose()
    }

    /// The frame that a session sent under `sequence`, if it is durable.
    pub(crate) async fn event_of_sequence(
        &self,
        map: MapId,
        session: SessionId,
        sequence: u64,
        vocabulary_len: usize,
    ) -> Result<Option<MapEvent>, StorageError> {
        let bytes: Option<Vec<u8>> =
            sqlx::query_scalar("SELECT event FROM log WHERE map_id = ? AND session = ? AND sequence = ?")
                .bind(map)
                .bind(session)
                .bind(to_sql(sequence))
                .fetch_optional(&self.readers)
                .await?;
        bytes.map(|bytes| event(&bytes, vocabulary_len)).transpose()
    }

    /// The frame that a session sent before another.
    pub(crate) async fn frame_before(
        &self,
        map: MapId,
        frame: &FrameEvent,
        vocabulary_len: usize,
    ) -> Result<Option<FrameEvent>, StorageError> {
        let bytes: Option<Vec<u8>> = sqlx::query_scalar(
            "SELECT event FROM log WHERE map_id = ? AND session = ? AND sequence < ? ORDER BY sequence DESC LIMIT 1",
        )
        .bind(map)
        .bind(frame.session)
        .bind(to_sql(frame.sequence))
        .fetch_optional(&self.readers)
        .await?;
        let event = bytes.map(|bytes| event(&bytes, vocabulary_len)).transpose()?;
        Ok(event.and_then(|event| match event {
            MapEvent::Frame(frame) => Some(*frame),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => None,
        }))
    }

    /// The last frames of a session, latest first.
    pub(crate) async fn last_frames(
        &self,
        map: MapId,
        session: SessionId,
        most: usize,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameEvent>, StorageError> {
        let rows: Vec<Vec<u8>> = sqlx::query_scalar(
            "SELECT event FROM log WHERE map_id = ? AND session = ? AND sequence IS NOT NULL \
             ORDER BY sequence DESC LIMIT ?",
        )
        .bind(map)
        .bind(session)
        .bind(to_sql(most as u64))
        .fetch_all(&self.readers)
        .await?;
        let events = rows.iter().map(|bytes| event(bytes, vocabulary_len)).collect::<Result<Vec<_>, _>>()?;
        let frame = |event: MapEvent| match event {
            MapEvent::Frame(frame) => Some(*frame),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => None,
        };
        Ok(events.into_iter().filter_map(frame).collect())
    }

    /// What robots measured at frames of a session, oldest first.
    pub(crate) async fn measured_of_session(
        &self,
        map: MapId,
        session: SessionId,
        vocabulary_len: usize,
    ) -> Result<Vec<MeasuredEvent>, StorageError> {
        let rows: Vec<Vec<u8>> = sqlx::query_scalar(
            "SELECT event FROM log WHERE map_id = ? AND session = ? AND sequence IS NULL ORDER BY position",
        )
        .bind(map)
        .bind(session)
        .fetch_all(&self.readers)
        .await?;
        let events = rows.iter().map(|bytes| event(bytes, vocabulary_len)).collect::<Result<Vec<_>, _>>()?;
        let measured = |event| match event {
            MapEvent::Measured(event) => Some(*event),
            MapEvent::SessionOpened { .. } | MapEvent::Frame(_) => None,
        };
        Ok(events.into_iter().filter_map(measured).collect())
    }

    /// The latest frames of a place that came in before `before`, latest first.
    pub(crate) async fn frames_of_place(
        &self,
        map: MapId,
        place: PlaceId,
        before: FrameId,
        limit: u32,
    ) -> Result<Vec<FrameId>, StorageError> {
        Ok(sqlx::query_scalar(
            "SELECT position FROM log WHERE map_id = ? AND place = ? AND position < ? ORDER BY position DESC LIMIT ?",
        )
        .bind(map)
        .bind(place.number())
        .bind(to_sql(before))
        .bind(limit)
        .fetch_all(&self.readers)
        .await?)
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
        // A list of numbers is JSON already.
        let positions = format!("{:?}", positions.into_iter().map(to_sql).collect::<Vec<_>>());
        let rows: Vec<(FrameId, SessionId, u64, i64, String)> = sqlx::query_as(
            "SELECT position, session, sequence, stamp_ns, coalesce(note, '') \
             FROM log LEFT JOIN frame_notes USING (map_id, position) \
             WHERE map_id = ? AND sequence IS NOT NULL AND position IN (SELECT value FROM json_each(?))",
        )
        .bind(map)
        .bind(positions)
        .fetch_all(&self.readers)
        .await?;
        let frame = |(position, session, sequence, stamp_ns, note)| {
            (position, StoredFrame { session, sequence, stamp_ns, note })
        };
        Ok(rows.into_iter().map(frame).collect())
    }

    /// Loop closures after log position `after` (all if `None`), oldest first.
    pub(crate) async fn loop_closures(
        &self,
        map: MapId,
        after: Option<u64>,
        limit: u32,
    ) -> Result<Vec<ClosureRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT f.position, f.session, f.sequence, f.stamp_ns, f.place, f.posterior, f.probability, \
             m.session AS matched_session, m.sequence AS matched_sequence, m.stamp_ns AS matched_stamp_ns, \
             coalesce(fn.note, '') AS note, coalesce(mn.note, '') AS matched_note \
             FROM log AS f JOIN log AS m ON m.map_id = f.map_id AND m.position = f.matched_frame \
             LEFT JOIN frame_notes AS fn ON fn.map_id = f.map_id AND fn.position = f.position \
             LEFT JOIN frame_notes AS mn ON mn.map_id = m.map_id AND mn.position = m.position \
             WHERE f.map_id = ? AND f.reason = 'loop_closure' AND f.position > ? ORDER BY f.position LIMIT ?",
        )
        .bind(map)
        .bind(after.map_or(-1, to_sql))
        .bind(limit)
        .fetch_all(&self.readers)
        .await?)
    }
}

pub(super) async fn insert_event(
    transaction: &mut Transaction<'_, Sqlite>,
    map: MapId,
    position: i64,
    event: &MapEvent,
) -> Result<(), StorageError> {
    let (frame, link): (_, Option<Link>) = match event {
        MapEvent::SessionOpened { .. } => (None, None),
        MapEvent::Frame(frame) => (Some(frame), frame.link),
        MapEvent::Measured(measured) => (None, measured.link),
    };
    let decision = frame.map(|frame| &frame.decision);
    sqlx::query(
        "INSERT INTO log (map_id, position, session, sequence, stamp_ns, reason, place, posterior, matched_frame, \
         probability, link_from, link_to, event) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(map)
    .bind(position)
    .bind(event.session())
    .bind(frame.map(|frame| to_sql(frame.sequence)))
    .bind(frame.map(|frame| frame.stamp_ns))
    .bind(decision.map(|decision| reason_name(decision.reason)))
    .bind(decision.and_then(|decision| decision.place).map(PlaceId::number))
    .bind(decision.map(|decision| decision.posterior))
    .bind(decision.and_then(|decision| decision.closure).map(|closure| to_sql(closure.frame)))
    .bind(frame.and_then(|frame| frame.verified_by()).map(Candidate::probability))
    .bind(link.map(|link| link.from.number()))
    .bind(link.map(|link| link.to.number()))
    .bind(event.to_bytes())
    .execute(&mut **transaction)
    .await?;
    Ok(())
}

/// A reason as the log, the metrics and people have it.
pub(crate) fn reason_name(reason: Reason) -> &'static str {
    match reason {
        Reason::NewPlace => "new_place",
        Reason::SamePlace => "same_place",
        Reason::LoopClosure => "loop_closure",
        Reason::BelowThreshold => "below_threshold",
        Reason::TooFewWords => "too_few_words",
        Reason::GeometryRefused => "geometry_refused",
    }
}

pub(super) fn event(bytes: &[u8], vocabulary_len: usize) -> Result<MapEvent, StorageError> {
    MapEvent::from_bytes(bytes, vocabulary_len).map_err(|error| StorageError::Damaged(error.to_string()))
}
