//! A log that is rewritten, without some sessions.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use sqlx::{Any, Transaction};
use topomap::ids::{FrameId, SessionId};
use topomap::log::MapEvent;
use topomap::rewriting::Retold;

use super::appearance::forget_links;
use super::checkpoints::CHECKPOINT_PIECES;
use super::jobs::end_job;
use super::kept::count_sessions;
use super::merges::set_outcome;
use super::new_events::{NewEvent, insert_events};
use super::values::{from_sql, json_list, to_sql};
use super::{
    FormerModelRow, JobEnd, LabelRow, MapEdition, MapId, MergeOutcome, MergeState, Storage, StorageError,
};

/// A log as it is to be from some position on.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RetoldLog {
    /// The map, as it was read.
    pub(crate) map: MapEdition,
    /// The first position that is another.
    pub(crate) from: u64,
    pub(crate) events: Vec<MapEvent>,
    /// Where the events from there on were that are still there, and where they are now: none comes later than it did.
    pub(crate) kept: BTreeMap<FrameId, FrameId>,
    /// What each place is now, by the number that it had; `None` if it is gone.
    pub(crate) places: Vec<Option<PlaceId>>,
    pub(crate) removed_sessions: Vec<SessionId>,
    /// Numbers that the others have now, by those that they had: none is higher than it was.
    pub(crate) sessions: BTreeMap<SessionId, SessionId>,
}

impl RetoldLog {
    /// What differs in a log that was rewritten.
    pub(crate) fn new(map: MapEdition, before: &[MapEvent], retold: Retold) -> Self {
        let Retold { mut events, frames, sessions, places, dropped: _ } = retold;
        // An event that has come to stand where one like it was removed is another, with other media.
        let stays = |position: u64, before: &MapEvent, now: &MapEvent| {
            frames.get(&position) == Some(&position) && before == now
        };
        let both = (0..).zip(before.iter().zip(&events));
        let same = both.take_while(|&(position, (before, now))| stays(position, before, now)).count();
        let opened = before.iter().filter_map(|event| match event {
            MapEvent::SessionOpened { session } => Some(*session),
            MapEvent::Frame(_) | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
        });
        let removed_sessions = opened.filter(|session| !sessions.contains_key(session)).collect();
        let kept = frames.range(same as u64..).map(|(before, now)| (*before, *now)).collect();
        Self {
            map,
            from: same as u64,
            events: events.split_off(same),
            kept,
            places,
            removed_sessions,
            sessions,
        }
    }
}

impl Storage {
    /// Replaces the end of a map's log, with its media and sessions, and ends a job and the merge that it undoes, if
    /// there are such: all or nothing. The checkpoint goes, and what panoramas were found to have in common.
    /// [`StorageError::Retold`] if the log was rewritten or the map deleted since it was read.
    pub(crate) async fn retell(
        &self,
        log: &RetoldLog,
        undone: Option<&MergeOutcome>,
        end: Option<&JobEnd>,
    ) -> Result<(), StorageError> {
        let map = log.map.map;
        self.check_sound(map)?;
        self.write_counted(async |transaction| {
            raise_edition(transaction, log.map).await?;
            move_kept(transaction, log).await?;
            move_former_models(transaction, log).await?;
            move_labels(transaction, log).await?;
            replace_events(transaction, log).await?;
            move_sessions(transaction, log).await?;
            count_sessions(transaction, map).await?;
            delete_checkpoint(transaction, map).await?;
            forget_links(transaction, map).await?;
            if let Some(undone) = undone {
                set_outcome(transaction, undone, MergeState::Committed).await?;
            }
            match end {
                Some(end) => end_job(transaction, end).await,
                None => Ok(()),
            }
        })
        .await
    }

    /// Makes all sessions of a map its own: what merges have brought is not taken out again.
    pub(crate) async fn end_undoing(&self, map: MapId) -> Result<(), StorageError> {
        self.write(async |transaction| {
            for forget in [
                "UPDATE sessions SET merge = NULL WHERE map_id = $1",
                "UPDATE merges SET map_id = NULL WHERE map_id = $1",
            ] {
                sqlx::query(forget).bind(map).execute(&mut **transaction).await?;
            }
            Ok(())
        })
        .await
    }

    /// Events of a map's log.
    pub(crate) async fn log_events(&self, map: MapId) -> Result<u64, StorageError> {
        let events = sqlx::query_scalar("SELECT coalesce(max(position) + 1, 0) FROM log WHERE map_id = $1")
            .bind(map)
            .fetch_one(&self.readers)
            .await?;
        from_sql(events)
    }

    /// The sessions that a merge has brought to a map.
    pub(crate) async fn sessions_of_merge(
        &self,
        map: MapId,
        merge: u64,
    ) -> Result<Vec<SessionId>, StorageError> {
        let numbers: Vec<i64> =
            sqlx::query_scalar("SELECT number FROM sessions WHERE map_id = $1 AND merge = $2")
                .bind(map)
                .bind(to_sql(merge))
                .fetch_all(&self.readers)
                .await?;
        numbers.into_iter().map(from_sql).collect()
    }
}

/// [`StorageError::Retold`] if the map is no longer of that edition.
async fn raise_edition(
    transaction: &mut Transaction<'_, Any>,
    MapEdition { map, edition }: MapEdition,
) -> Result<(), StorageError> {
    let done = sqlx::query(
        "UPDATE maps SET edition = edition + 1 WHERE id = $1 AND edition = $2 AND state = 'live'",
    )
    .bind(map)
    .bind(to_sql(edition))
    .execute(&mut **transaction)
    .await?;
    if done.rows_affected() == 1 { Ok(()) } else { Err(StorageError::Retold) }
}

/// What is kept of frames beside the log.
const BESIDE_FRAMES: [&str; 2] = ["frame_media", "frame_notes"];

/// What is kept of frames that stay gets the frames' new positions; the rest goes.
async fn move_kept(transaction: &mut Transaction<'_, Any>, log: &RetoldLog) -> Result<(), StorageError> {
    let map = log.map.map;
    let positions = json_list(log.kept.keys().copied().map(to_sql));
    for table in BESIDE_FRAMES {
        let delete = format!(
            "DELETE FROM {table} WHERE map_id = $1 AND position >= $2 \
             AND position NOT IN (SELECT value FROM json_each($3))"
        );
        sqlx::query(sqlx::AssertSqlSafe(delete))
            .bind(map)
            .bind(to_sql(log.from))
            .bind(&positions)
            .execute(&mut **transaction)
            .await?;
    }
    // In order, so that each finds its new position free.
    for (before, now) in log.kept.iter().filter(|(before, now)| before != now) {
        for table in BESIDE_FRAMES {
            let renumber = format!("UPDATE {table} SET position = $1 WHERE map_id = $2 AND position = $3");
            sqlx::query(sqlx::AssertSqlSafe(renumber))
                .bind(to_sql(*now))
                .bind(map)
                .bind(to_sql(*before))
                .execute(&mut **transaction)
                .await?;
        }
    }
    Ok(())
}

async fn replace_events(transaction: &mut Transaction<'_, Any>, log: &RetoldLog) -> Result<(), StorageError> {
    let map = log.map.map;
    sqlx::query("DELETE FROM log WHERE map_id = $1 AND position >= $2")
        .bind(map)
        .bind(to_sql(log.from))
        .execute(&mut **transaction)
        .await?;
    let events: Vec<NewEvent<'_>> =
        (log.from..).zip(&log.events).map(|(position, event)| NewEvent { map, position, event }).collect();
    insert_events(transaction, &events).await.map(drop)
}

async fn move_sessions(transaction: &mut Transaction<'_, Any>, log: &RetoldLog) -> Result<(), StorageError> {
    let map = log.map.map;
    for session in &log.removed_sessions {
        sqlx::query("DELETE FROM sessions WHERE map_id = $1 AND number = $2")
            .bind(map)
            .bind(i64::from(*session))
            .execute(&mut **transaction)
            .await?;
    }
    // In order, so that each finds its new number free.
    for (before, now) in log.sessions.iter().filter(|(before, now)| before != now) {
        sqlx::query("UPDATE sessions SET number = $1 WHERE map_id = $2 AND number = $3")
            .bind(i64::from(*now))
            .bind(map)
            .bind(i64::from(*before))
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}

async fn delete_checkpoint(transaction: &mut Transaction<'_, Any>, map: MapId) -> Result<(), StorageError> {
    for table in CHECKPOINT_PIECES.into_iter().map(|(table, ..)| table).chain(["checkpoints"]) {
        sqlx::query(sqlx::AssertSqlSafe(format!("DELETE FROM {table} WHERE map_id = $1")))
            .bind(map)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}

/// A former model was in use up to an event that may be another by now.
async fn move_former_models(
    transaction: &mut Transaction<'_, Any>,
    log: &RetoldLog,
) -> Result<(), StorageError> {
    let former =
        sqlx::query_as("SELECT until_events, model FROM map_models WHERE map_id = $1 AND until_events > $2")
            .bind(log.map.map)
            .bind(to_sql(log.from))
            .fetch_all(&mut **transaction)
            .await?;
    sqlx::query("DELETE FROM map_models WHERE map_id = $1 AND until_events > $2")
        .bind(log.map.map)
        .bind(to_sql(log.from))
        .execute(&mut **transaction)
        .await?;
    for FormerModelRow { until_events, model } in former {
        let kept = log.kept.range(log.from..until_events).count() as u64;
        // Of two that have come to end at the same event, the later one was in use for none.
        sqlx::query(
            "INSERT INTO map_models (map_id, until_events, model) VALUES ($1, $2, $3) ON CONFLICT DO NOTHING",
        )
        .bind(log.map.map)
        .bind(to_sql(log.from + kept))
        .bind(model)
        .execute(&mut **transaction)
        .await?;
    }
    Ok(())
}

/// Places keep what they are called, whatever their numbers.
async fn move_labels(transaction: &mut Transaction<'_, Any>, log: &RetoldLog) -> Result<(), StorageError> {
    let labels = sqlx::query_as("DELETE FROM labels WHERE map_id = $1 RETURNING place, label")
        .bind(log.map.map)
        .fetch_all(&mut **transaction)
        .await?;
    for LabelRow { place, label } in labels {
        let Some(now) = log.places.get(place.index()).copied().flatten() else { continue };
        sqlx::query("INSERT INTO labels (map_id, place, label) VALUES ($1, $2, $3)")
            .bind(log.map.map)
            .bind(i64::from(now.number()))
            .bind(label)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}
