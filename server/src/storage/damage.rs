//! Maps of which something is damaged on the disk: they are read where they can be, and take nothing more.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

use topomap::ids::FrameId;

use super::values::to_sql;
use super::{MapId, Storage, StorageError};
use crate::clock::now_ns;

/// What was found first in each map that is damaged.
#[derive(Debug, Default)]
pub(super) struct Damages(RwLock<BTreeMap<MapId, String>>);

/// Where in a map something was read that is damaged.
#[derive(Clone, Copy, Debug)]
pub(super) enum Where {
    Somewhere,
    /// At this position of its log.
    Event(FrameId),
}

/// An event that the log had.
pub(super) fn gone(position: FrameId) -> StorageError {
    StorageError::Rot(format!("event {position} of the log is gone"))
}

impl Storage {
    pub(super) async fn load_damages(&self) -> Result<(), StorageError> {
        let rows: Vec<(MapId, String)> =
            sqlx::query_as("SELECT map_id, found FROM map_damage").fetch_all(&self.readers).await?;
        self.damages.0.write().unwrap_or_else(PoisonError::into_inner).extend(rows);
        Ok(())
    }

    /// What was found in a map that is damaged.
    pub(crate) fn damage(&self, map: MapId) -> Option<String> {
        self.damages.0.read().unwrap_or_else(PoisonError::into_inner).get(&map).cloned()
    }

    /// [`StorageError::ReadOnly`] if a map is damaged: what is added to it could rest on what is lost.
    pub(crate) fn check_sound(&self, map: MapId) -> Result<(), StorageError> {
        self.damage(map).map_or(Ok(()), |found| Err(StorageError::ReadOnly(found)))
    }

    /// What was read of a map. If it is damaged, the map is noted as such, and the error names it.
    pub(super) async fn noting_rot<T>(
        &self,
        map: MapId,
        place: Where,
        read: Result<T, StorageError>,
    ) -> Result<T, StorageError> {
        match read {
            Err(StorageError::Rot(what)) => Err(StorageError::Rot(self.note_rot(map, place, &what).await)),
            other => other,
        }
    }

    /// Notes that a map's log has lost an event that it had.
    pub(crate) async fn event_is_gone(&self, map: MapId, position: FrameId) -> StorageError {
        let lost: Result<(), _> = self.noting_rot(map, Where::Event(position), Err(gone(position))).await;
        lost.err().unwrap_or_else(|| gone(position))
    }

    /// Notes it if a map's log has lost events of the first `events`, which a checkpoint has folded in. Those between are
    /// seen by who reads them.
    pub(crate) async fn check_log_reaches(&self, map: MapId, events: u64) -> Result<(), StorageError> {
        let Some(last) = events.checked_sub(1) else { return Ok(()) };
        let there = sqlx::query_scalar("SELECT count(*) FROM log WHERE map_id = $1 AND position = $2");
        let there: i64 = there.bind(map).bind(to_sql(last)).fetch_one(&self.readers).await?;
        if there == 0 {
            // It is noted, and said to who adds to the map; what there is can be read.
            let _ = self.event_is_gone(map, last).await;
        }
        Ok(())
    }

    /// Notes that a map is damaged; says where.
    pub(super) async fn note_rot(&self, map: MapId, place: Where, what: &str) -> String {
        let found = format!("{}: {what}", self.named(map, place).await);
        let first = {
            let mut damages = self.damages.0.write().unwrap_or_else(PoisonError::into_inner);
            damages.insert(map, found.clone()).is_none()
        };
        tracing::error!(map, found, "damage on the disk; the map is read-only from now on");
        if first {
            let noted = sqlx::query(
                "INSERT INTO map_damage (map_id, found, found_ns) VALUES ($1, $2, $3) ON CONFLICT DO NOTHING",
            );
            let noted = self
                .write(async |transaction| {
                    noted.bind(map).bind(&found).bind(now_ns()).execute(&mut **transaction).await?;
                    Ok(())
                })
                .await;
            if let Err(error) = noted {
                tracing::error!(map, %error, "the damage could not be noted; it will be found again");
            }
        }
        found
    }

    /// A map, and an event of it, as people name them, as far as that can still be read.
    pub(super) async fn named(&self, map: MapId, place: Where) -> String {
        let name = sqlx::query_scalar("SELECT name FROM maps WHERE id = $1").bind(map);
        let name: Option<String> = name.fetch_optional(&self.readers).await.ok().flatten();
        let name = name.map_or_else(|| format!("map number {map}"), |name| format!("map {name}"));
        let Where::Event(position) = place else { return name };
        let frame = sqlx::query_as(
            "SELECT s.name, l.sequence FROM log AS l JOIN sessions AS s ON s.map_id = l.map_id AND s.number = l.session \
             WHERE l.map_id = $1 AND l.position = $2",
        );
        let frame = frame.bind(map).bind(to_sql(position)).fetch_optional(&self.readers).await;
        let frame: Option<(String, Option<i64>)> = frame.ok().flatten();
        match frame {
            Some((session, Some(sequence))) => format!("{name}, session {session}, frame {sequence}"),
            Some((session, None)) => format!("{name}, session {session}, event {position} of the log"),
            None => format!("{name}, event {position} of the log"),
        }
    }
}
