use topomap::ids::{FrameId, SessionId};
use topomap::log::{FrameEvent, MapEvent};

use super::damage::Where;
use super::row_sums::StoredEvent;
use super::values::{MaybeWhole, from_sql, to_sql};
use super::{MapId, Storage, StorageError};
use crate::camera::Camera;

/// A session with what its frames add up to.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct SessionSummary {
    #[sqlx(try_from = "i64")]
    pub(crate) number: SessionId,
    pub(crate) name: String,
    pub(crate) camera: Option<Camera>,
    pub(crate) opened_ns: i64,
    #[sqlx(try_from = "i64")]
    pub(crate) frames: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) loop_closures: u64,
    #[sqlx(try_from = "MaybeWhole")]
    pub(crate) first_sequence: Option<u64>,
    #[sqlx(try_from = "MaybeWhole")]
    pub(crate) last_sequence: Option<u64>,
    pub(crate) first_stamp_ns: Option<i64>,
    pub(crate) last_stamp_ns: Option<i64>,
    /// Name of the token that opened it, if one did.
    pub(crate) owner: Option<String>,
    #[sqlx(try_from = "i64")]
    pub(crate) kept_bytes: u64,
}

/// A frame with the sizes of what is kept of it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameRow {
    pub(crate) event: FrameEvent,
    /// What its robot calls it; empty if nothing.
    pub(crate) note: String,
    pub(crate) bytes: FrameBytes,
}

/// What is kept of a frame; 0 where nothing is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct FrameBytes {
    #[sqlx(try_from = "i64")]
    pub(crate) log: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) features: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) thumbnail: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) image: u64,
}

/// A frame whose event is still to be decoded.
#[derive(sqlx::FromRow)]
struct FrameColumns {
    #[sqlx(flatten)]
    event: StoredEvent,
    note: String,
    #[sqlx(flatten)]
    bytes: FrameBytes,
}

/// Stamps rise with sequence numbers, so the least and greatest of both are of the same frames.
const SESSION_COLUMNS: &str = "number, name, camera, opened_ns, owner, kept_bytes, \
     (SELECT count(*) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS frames, \
     (SELECT count(*) FROM log WHERE map_id = s.map_id AND session = s.number AND reason = 'loop_closure') AS loop_closures, \
     (SELECT min(sequence) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS first_sequence, \
     (SELECT max(sequence) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS last_sequence, \
     (SELECT min(stamp_ns) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS first_stamp_ns, \
     (SELECT max(stamp_ns) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS last_stamp_ns \
     FROM sessions AS s";

/// What a frame is called.
const NOTE: &str =
    "coalesce((SELECT note FROM frame_notes WHERE map_id = l.map_id AND position = l.position), '')";

const FRAME_COLUMNS: &str = "position, event, checksum, chain, length(event) AS log, \
     coalesce((SELECT note FROM frame_notes WHERE map_id = l.map_id AND position = l.position), '') AS note, \
     coalesce((SELECT coalesce(object_bytes, length(content)) FROM frame_media WHERE map_id = l.map_id AND position = l.position AND kind = 'features'), 0) AS features, \
     coalesce((SELECT coalesce(object_bytes, length(content)) FROM frame_media WHERE map_id = l.map_id AND position = l.position AND kind = 'thumbnail'), 0) AS thumbnail, \
     coalesce((SELECT coalesce(object_bytes, length(content)) FROM frame_media WHERE map_id = l.map_id AND position = l.position AND kind = 'image'), 0) AS image \
     FROM log AS l";

impl Storage {
    /// Sessions from number `from` on, by number.
    pub(crate) async fn session_summaries(
        &self,
        map: MapId,
        from: SessionId,
        limit: u32,
    ) -> Result<Vec<SessionSummary>, StorageError> {
        let sql =
            format!("SELECT {SESSION_COLUMNS} WHERE map_id = $1 AND number >= $2 ORDER BY number LIMIT $3");
        let query =
            sqlx::query_as(sqlx::AssertSqlSafe(sql)).bind(map).bind(i64::from(from)).bind(i64::from(limit));
        let summaries = query.fetch_all(&self.readers).await;
        self.noting_rot(map, Where::Somewhere, summaries.map_err(StorageError::from)).await
    }

    pub(crate) async fn session_summary(
        &self,
        map: MapId,
        name: &str,
    ) -> Result<Option<SessionSummary>, StorageError> {
        let sql = format!("SELECT {SESSION_COLUMNS} WHERE map_id = $1 AND name = $2");
        let query = sqlx::query_as(sqlx::AssertSqlSafe(sql)).bind(map).bind(name);
        let summary = query.fetch_optional(&self.readers).await;
        self.noting_rot(map, Where::Somewhere, summary.map_err(StorageError::from)).await
    }

    /// The number of the session of that name.
    pub(crate) async fn session_number(
        &self,
        map: MapId,
        name: &str,
    ) -> Result<Option<SessionId>, StorageError> {
        let number: Option<i64> =
            sqlx::query_scalar("SELECT number FROM sessions WHERE map_id = $1 AND name = $2")
                .bind(map)
                .bind(name)
                .fetch_optional(&self.readers)
                .await?;
        number.map(from_sql).transpose()
    }

    /// Frames of a session whose sequence number is above `after` (all if `None`), by number; only those with that note,
    /// unless it is empty.
    pub(crate) async fn frames_of_session(
        &self,
        map: MapId,
        session: SessionId,
        after: Option<u64>,
        note: &str,
        limit: u32,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameRow>, StorageError> {
        let sql = format!(
            "SELECT {FRAME_COLUMNS} WHERE map_id = $1 AND session = $2 AND sequence > $3 AND ($4 = '' OR $4 = {NOTE}) \
             ORDER BY sequence LIMIT $5"
        );
        let query = sqlx::query_as(sqlx::AssertSqlSafe(sql)).bind(map).bind(i64::from(session));
        let query = query.bind(after.map_or(-1, to_sql)).bind(note).bind(i64::from(limit));
        self.frame_rows(map, query.fetch_all(&self.readers).await, vocabulary_len).await
    }

    /// Frames from log position `from` on, by position.
    pub(crate) async fn frames_from(
        &self,
        map: MapId,
        from: FrameId,
        limit: u32,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameRow>, StorageError> {
        let sql = format!(
            "SELECT {FRAME_COLUMNS} WHERE map_id = $1 AND position >= $2 AND sequence IS NOT NULL \
             ORDER BY position LIMIT $3"
        );
        let query =
            sqlx::query_as(sqlx::AssertSqlSafe(sql)).bind(map).bind(to_sql(from)).bind(i64::from(limit));
        self.frame_rows(map, query.fetch_all(&self.readers).await, vocabulary_len).await
    }

    /// The frame that a session sent under `sequence`.
    pub(crate) async fn frame_of_sequence(
        &self,
        map: MapId,
        session: SessionId,
        sequence: u64,
        vocabulary_len: usize,
    ) -> Result<Option<FrameRow>, StorageError> {
        let sql = format!("SELECT {FRAME_COLUMNS} WHERE map_id = $1 AND session = $2 AND sequence = $3");
        let query = sqlx::query_as(sqlx::AssertSqlSafe(sql))
            .bind(map)
            .bind(i64::from(session))
            .bind(to_sql(sequence));
        let rows = query.fetch_all(&self.readers).await;
        Ok(self.frame_rows(map, rows, vocabulary_len).await?.pop())
    }

    async fn frame_rows(
        &self,
        map: MapId,
        rows: Result<Vec<FrameColumns>, sqlx::Error>,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameRow>, StorageError> {
        let rows = self.noting_rot(map, Where::Somewhere, rows.map_err(StorageError::from)).await?;
        let mut frames = Vec::with_capacity(rows.len());
        for row in rows {
            let frame = frame_row(&row, vocabulary_len);
            frames.push(self.noting_rot(map, Where::Event(row.event.position), frame).await?);
        }
        Ok(frames)
    }

    /// Position in the log of the frame that a session sent under `sequence`.
    pub(crate) async fn position_of_sequence(
        &self,
        map: MapId,
        session: SessionId,
        sequence: u64,
    ) -> Result<Option<FrameId>, StorageError> {
        let select = "SELECT position FROM log WHERE map_id = $1 AND session = $2 AND sequence = $3";
        let query = sqlx::query_scalar(select).bind(map).bind(i64::from(session)).bind(to_sql(sequence));
        let position: Result<Option<i64>, _> = query.fetch_optional(&self.readers).await;
        let position = self.noting_rot(map, Where::Somewhere, position.map_err(StorageError::from)).await?;
        position.map(from_sql).transpose()
    }
}

fn frame_row(row: &FrameColumns, vocabulary_len: usize) -> Result<FrameRow, StorageError> {
    let MapEvent::Frame(event) = row.event.decode(vocabulary_len)? else {
        return Err(StorageError::Damaged("a frame of the log that is none".to_owned()));
    };
    Ok(FrameRow { event: *event, note: row.note.clone(), bytes: row.bytes })
}
