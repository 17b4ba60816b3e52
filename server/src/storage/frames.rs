use sqlx::Row;
use sqlx::sqlite::SqliteRow;
use topomap::event::{FrameEvent, FrameId, MapEvent, SessionId};

use super::log::event;
use super::{MapId, Storage, StorageError, from_sql, to_sql};

/// A session with what its frames add up to.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SessionSummary {
    pub(crate) number: SessionId,
    pub(crate) name: String,
    /// An encoded `waypost.v1.Camera`.
    pub(crate) camera: Option<Vec<u8>>,
    pub(crate) opened_ns: i64,
    pub(crate) frames: u64,
    pub(crate) loop_closures: u64,
    pub(crate) first_sequence: Option<u64>,
    pub(crate) last_sequence: Option<u64>,
    pub(crate) first_stamp_ns: Option<i64>,
    pub(crate) last_stamp_ns: Option<i64>,
}

/// A frame with the sizes of what is kept of it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameRow {
    pub(crate) event: FrameEvent,
    pub(crate) log_bytes: u64,
    pub(crate) features_bytes: u64,
    pub(crate) thumbnail_bytes: u64,
    pub(crate) image_bytes: u64,
}

/// Stamps rise with sequence numbers, so the least and greatest of both are of the same frames.
const SESSION_COLUMNS: &str = "number, name, camera, opened_ns, \
     (SELECT count(*) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS frames, \
     (SELECT count(*) FROM log WHERE map_id = s.map_id AND session = s.number AND reason = 'loop_closure') AS loop_closures, \
     (SELECT min(sequence) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS first_sequence, \
     (SELECT max(sequence) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS last_sequence, \
     (SELECT min(stamp_ns) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS first_stamp_ns, \
     (SELECT max(stamp_ns) FROM log WHERE map_id = s.map_id AND session = s.number AND sequence IS NOT NULL) AS last_stamp_ns \
     FROM sessions AS s";

const FRAME_COLUMNS: &str = "position, sequence, event, length(event) AS log_bytes, \
     (SELECT length(content) FROM frame_media WHERE map_id = l.map_id AND position = l.position AND kind = 'features') AS features_bytes, \
     (SELECT length(content) FROM frame_media WHERE map_id = l.map_id AND position = l.position AND kind = 'thumbnail') AS thumbnail_bytes, \
     (SELECT length(content) FROM frame_media WHERE map_id = l.map_id AND position = l.position AND kind = 'image') AS image_bytes \
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
            format!("SELECT {SESSION_COLUMNS} WHERE map_id = ? AND number >= ? ORDER BY number LIMIT ?");
        let rows = sqlx::query(sqlx::AssertSqlSafe(sql))
            .bind(map)
            .bind(from)
            .bind(limit)
            .fetch_all(&self.readers)
            .await?;
        rows.iter().map(session_summary).collect()
    }

    pub(crate) async fn session_summary(
        &self,
        map: MapId,
        name: &str,
    ) -> Result<Option<SessionSummary>, StorageError> {
        let sql = format!("SELECT {SESSION_COLUMNS} WHERE map_id = ? AND name = ?");
        let row =
            sqlx::query(sqlx::AssertSqlSafe(sql)).bind(map).bind(name).fetch_optional(&self.readers).await?;
        row.as_ref().map(session_summary).transpose()
    }

    /// The number of the session of that name.
    pub(crate) async fn session_number(
        &self,
        map: MapId,
        name: &str,
    ) -> Result<Option<SessionId>, StorageError> {
        let row = sqlx::query("SELECT number FROM sessions WHERE map_id = ? AND name = ?")
            .bind(map)
            .bind(name)
            .fetch_optional(&self.readers)
            .await?;
        Ok(row.map(|row| row.try_get("number")).transpose()?)
    }

    /// Frames of a session whose sequence number is above `after` (all if `None`), by number.
    pub(crate) async fn frames_of_session(
        &self,
        map: MapId,
        session: SessionId,
        after: Option<u64>,
        limit: u32,
        vocabulary_len: usize,
    ) -> Result<Vec<FrameRow>, StorageError> {
        let sql = format!(
            "SELECT {FRAME_COLUMNS} WHERE map_id = ? AND session = ? AND sequence > ? ORDER BY sequence LIMIT ?"
        );
        let rows = sqlx::query(sqlx::AssertSqlSafe(sql))
            .bind(map)
            .bind(session)
            .bind(after.map_or(-1, to_sql))
            .bind(limit)
            .fetch_all(&self.readers)
            .await?;
        rows.iter().map(|row| frame_row(row, vocabulary_len)).collect()
    }

    /// The frame that a session sent under `sequence`.
    pub(crate) async fn frame_of_sequence(
        &self,
        map: MapId,
        session: SessionId,
        sequence: u64,
        vocabulary_len: usize,
    ) -> Result<Option<FrameRow>, StorageError> {
        let sql = format!("SELECT {FRAME_COLUMNS} WHERE map_id = ? AND session = ? AND sequence = ?");
        let row = sqlx::query(sqlx::AssertSqlSafe(sql))
            .bind(map)
            .bind(session)
            .bind(to_sql(sequence))
            .fetch_optional(&self.readers)
            .await?;
        row.as_ref().map(|row| frame_row(row, vocabulary_len)).transpose()
    }

    /// Position in the log of the frame that a session sent under `sequence`.
    pub(crate) async fn position_of_sequence(
        &self,
        map: MapId,
        session: SessionId,
        sequence: u64,
    ) -> Result<Option<FrameId>, StorageError> {
        let row = sqlx::query("SELECT position FROM log WHERE map_id = ? AND session = ? AND sequence = ?")
            .bind(map)
            .bind(session)
            .bind(to_sql(sequence))
            .fetch_optional(&self.readers)
            .await?;
        row.map(|row| from_sql(row.try_get("position")?)).transpose()
    }
}

fn session_summary(row: &SqliteRow) -> Result<SessionSummary, StorageError> {
    let sequence = |column| -> Result<Option<u64>, StorageError> {
        row.try_get::<Option<i64>, _>(column)?.map(from_sql).transpose()
    };
    Ok(SessionSummary {
        number: row.try_get("number")?,
        name: row.try_get("name")?,
        camera: row.try_get("camera")?,
        opened_ns: row.try_get("opened_ns")?,
        frames: from_sql(row.try_get("frames")?)?,
        loop_closures: from_sql(row.try_get("loop_closures")?)?,
        first_sequence: sequence("first_sequence")?,
        last_sequence: sequence("last_sequence")?,
        first_stamp_ns: row.try_get("first_stamp_ns")?,
        last_stamp_ns: row.try_get("last_stamp_ns")?,
    })
}

fn frame_row(row: &SqliteRow, vocabulary_len: usize) -> Result<FrameRow, StorageError> {
    let bytes = |column| -> Result<u64, StorageError> {
        from_sql(row.try_get::<Option<i64>, _>(column)?.unwrap_or_default())
    };
    let MapEvent::Frame(event) = event(row, vocabulary_len)? else {
        return Err(StorageError::Damaged("a frame of the log that is none".to_owned()));
    };
    Ok(FrameRow {
        event: *event,
        log_bytes: bytes("log_bytes")?,
        features_bytes: bytes("features_bytes")?,
        thumbnail_bytes: bytes("thumbnail_bytes")?,
        image_bytes: bytes("image_bytes")?,
    })
}
