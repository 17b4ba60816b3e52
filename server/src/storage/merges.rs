// long: what one merge writes and reads, from its first row to its undoing.
//! Maps that become one: what was found, and how it is stored.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use sqlx::{Any, Transaction};
use topomap::ids::SessionId;
use topomap::log::MapEvent;

use super::jobs::{ErrorColumns, end_job};
use super::kept::{count_sessions, kept_by_maps};
use super::maps::check_edition;
use super::new_events::{NewEvent, insert_events};
use super::notes::copy_notes;
use super::values::{from_sql, to_sql, words};
use super::{JobEnd, LabelRow, MapEdition, MapId, MapRow, Storage, StorageError, StoredError, StoredSession};

/// A merge as the table has it.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct MergeRow {
    #[sqlx(try_from = "i64")]
    pub(crate) number: u64,
    /// The name of the map that the sources go into.
    pub(crate) target: String,
    /// That map, once it has them and while it is there.
    #[sqlx(rename = "map_id")]
    pub(crate) map: Option<MapId>,
    /// What works on it, or did last.
    #[sqlx(try_from = "i64")]
    pub(crate) job: u64,
    pub(crate) state: MergeState,
    /// JSON.
    pub(crate) report: String,
    /// Why it failed, for the user.
    #[sqlx(flatten, try_from = "ErrorColumns")]
    pub(crate) error: Option<StoredError>,
    pub(crate) created_ns: i64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MergeState {
    Searching,
    /// Found; a person has to decide.
    Proposed,
    /// As far as can be told.
    NoOverlap,
    Committed,
    Discarded,
    Undone,
    Failed,
}

words!(MergeState {
    Searching = "searching",
    Proposed = "proposed",
    NoOverlap = "apart",
    Committed = "committed",
    Discarded = "discarded",
    Undone = "undone",
    Failed = "failed",
});

/// What a merge has come to.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MergeOutcome {
    pub(crate) number: u64,
    pub(crate) state: MergeState,
    /// JSON.
    pub(crate) report: String,
}

/// A source's log, rewritten as the target's.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JoinedLog {
    pub(crate) source: MapEdition,
    /// Position of its first event in the target's log; the others follow one by one.
    pub(crate) from: u64,
    pub(crate) events: Vec<MapEvent>,
    pub(crate) sessions: Vec<JoinedSession>,
    /// What the source's places are in the target.
    pub(crate) places: BTreeMap<PlaceId, PlaceId>,
}

/// A session of a source, as one of the target.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JoinedSession {
    pub(crate) of_source: SessionId,
    pub(crate) number: SessionId,
    pub(crate) name: String,
}

const COLUMNS: &str = "number, target, map_id, job, state, report, error, error_code, created_ns";

impl Storage {
    /// Adds a merge that is looked for; gives its number.
    pub(crate) async fn insert_merge(
        &self,
        target: &str,
        report: &str,
        created_ns: i64,
    ) -> Result<u64, StorageError> {
        self.write(async |transaction| {
            let number = sqlx::query_scalar(
                "INSERT INTO merges (target, job, state, report, created_ns) VALUES ($1, 0, 'searching', $2, $3) \
                 RETURNING number",
            )
            .bind(target)
            .bind(report)
            .bind(created_ns)
            .fetch_one(&mut **transaction)
            .await?;
            from_sql(number)
        })
        .await
    }

    pub(crate) async fn merge(&self, number: u64) -> Result<Option<MergeRow>, StorageError> {
        let query = format!("SELECT {COLUMNS} FROM merges WHERE number = $1");
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(query))
            .bind(to_sql(number))
            .fetch_optional(&self.readers)
            .await?)
    }

    /// Merges with a number below `before` (all if `None`), newest first.
    pub(crate) async fn merges(
        &self,
        before: Option<u64>,
        limit: u32,
    ) -> Result<Vec<MergeRow>, StorageError> {
        let query = format!("SELECT {COLUMNS} FROM merges WHERE number < $1 ORDER BY number DESC LIMIT $2");
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(query))
            .bind(before.map_or(i64::MAX, to_sql))
            .bind(i64::from(limit))
            .fetch_all(&self.readers)
            .await?)
    }

    /// The maps before and after, as SVG.
    pub(crate) async fn merge_picture(&self, number: u64) -> Result<Option<String>, StorageError> {
        let picture: Option<Option<String>> =
            sqlx::query_scalar("SELECT picture FROM merges WHERE number = $1")
                .bind(to_sql(number))
                .fetch_optional(&self.readers)
                .await?;
        Ok(picture.flatten())
    }

    /// Says which job works on a merge.
    pub(crate) async fn set_merge_job(&self, number: u64, job: u64) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query("UPDATE merges SET job = $1 WHERE number = $2")
                .bind(to_sql(job))
                .bind(to_sql(number))
                .execute(&mut **transaction)
                .await?;
            Ok(())
        })
        .await
    }

    /// Notes what the search has found, with its picture; ends its job, too, if nothing is to follow.
    pub(crate) async fn end_search(
        &self,
        outcome: &MergeOutcome,
        picture: Option<&str>,
        end: Option<&JobEnd>,
    ) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query("UPDATE merges SET picture = $1 WHERE number = $2")
                .bind(picture)
                .bind(to_sql(outcome.number))
                .execute(&mut **transaction)
                .await?;
            set_outcome(transaction, outcome, MergeState::Searching).await?;
            match end {
                Some(end) => end_job(transaction, end).await,
                None => Ok(()),
            }
        })
        .await
    }

    /// A proposal that nobody wants; whether it was one.
    pub(crate) async fn discard_merge(&self, number: u64) -> Result<bool, StorageError> {
        self.write(async |transaction| {
            let done =
                sqlx::query("UPDATE merges SET state = 'discarded' WHERE number = $1 AND state = 'proposed'")
                    .bind(to_sql(number))
                    .execute(&mut **transaction)
                    .await?;
            Ok(done.rows_affected() == 1)
        })
        .await
    }

    /// A search that came to no end, or a proposal that cannot be committed.
    pub(crate) async fn fail_merge(&self, number: u64, error: &StoredError) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query(
                "UPDATE merges SET state = 'failed', error = $1, error_code = $2 \
                 WHERE number = $3 AND state IN ('searching', 'proposed')",
            )
            .bind(&error.message)
            .bind(&error.code)
            .bind(to_sql(number))
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// A search that another server began, and perhaps came to an end of, is begun again.
    pub(crate) async fn begin_search_again(&self, number: u64, report: &str) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query(
                "UPDATE merges SET state = 'searching', report = $1, picture = NULL \
                 WHERE number = $2 AND state IN ('searching', 'proposed')",
            )
            .bind(report)
            .bind(to_sql(number))
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// What a job looked for, or was to commit, has failed with it.
    pub(crate) async fn fail_merge_of_job(&self, job: u64, error: &StoredError) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query(
                "UPDATE merges SET state = 'failed', error = $1, error_code = $2 \
                 WHERE job = $3 AND state IN ('searching', 'proposed')",
            )
            .bind(&error.message)
            .bind(&error.code)
            .bind(to_sql(job))
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// All that are looked for or wait for a decision have failed, but for those with whose job this server goes on: for its
    /// start, when it knows nothing of them.
    pub(crate) async fn fail_open_merges(&self, error: &StoredError) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query(
                "UPDATE merges SET state = 'failed', error = $1, error_code = $2 \
                 WHERE state IN ('searching', 'proposed') \
                 AND job NOT IN (SELECT number FROM jobs WHERE state = 'running' AND task IS NOT NULL)",
            )
            .bind(&error.message)
            .bind(&error.code)
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// The sessions of a map with all that is stored of them.
    pub(crate) async fn stored_sessions(&self, map: MapId) -> Result<Vec<StoredSession>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT number, name, camera, opened_ns FROM sessions WHERE map_id = $1 ORDER BY number",
        )
        .bind(map)
        .fetch_all(&self.readers)
        .await?)
    }

    /// A map by its number, if it is there.
    pub(crate) async fn map_of_id(&self, map: MapId) -> Result<Option<MapRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT id, name, model, settings, created_ns, edition FROM maps WHERE id = $1 AND state = 'live'",
        )
        .bind(map)
        .fetch_optional(&self.readers)
        .await?)
    }

    /// Appends sources to a map's log, with their sessions and media, and ends merge and job: all or nothing.
    /// [`StorageError::Retold`] if a source was rewritten or deleted since it was read.
    pub(crate) async fn append_merged(
        &self,
        target: MapId,
        joined: &[JoinedLog],
        outcome: &MergeOutcome,
        end: &JobEnd,
    ) -> Result<(), StorageError> {
        self.check_sound(target)?;
        self.write_counted(async |transaction| {
            let sources: Vec<MapId> = joined.iter().map(|log| log.source.map).collect();
            let (sessions, bytes) = kept_by_maps(transaction, &sources).await?;
            self.quotas.check_copies(sessions, bytes)?;
            for log in joined {
                check_edition(transaction, log.source).await?;
                insert_sessions_and_labels(transaction, target, log, outcome.number).await?;
                let new = |(position, event)| NewEvent { map: target, position, event };
                insert_events(transaction, &(log.from..).zip(&log.events).map(new).collect::<Vec<_>>())
                    .await?;
                let events = log.events.len() as u64;
                copy_media(transaction, log.source.map, target, 0..events, log.from).await?;
            }
            count_sessions(transaction, target).await?;
            commit(transaction, target, outcome, end).await
        })
        .await
    }

    /// Begins a map that is to hold several: one that nobody sees yet, with the base's sessions.
    /// [`StorageError::Exists`] if the name is taken. It counts for the quota of `owner`, a token.
    pub(crate) async fn begin_merged_map(
        &self,
        name: &str,
        base: &MapRow,
        made_of: &[MapId],
        owner: Option<&str>,
        created_ns: i64,
    ) -> Result<MapId, StorageError> {
        self.write_counted(async |transaction| {
            self.quotas.check_map(owner)?;
            let (sessions, bytes) = kept_by_maps(transaction, made_of).await?;
            self.quotas.check_copies(sessions, bytes)?;
            let map = sqlx::query_scalar(
                "INSERT INTO maps (name, model, settings, created_ns, state, owner) \
                 VALUES ($1, $2, $3, $4, 'importing', $5) RETURNING id",
            )
            .bind(name)
            .bind(&base.model)
            .bind(&base.settings)
            .bind(created_ns)
            .bind(owner)
            .fetch_one(&mut **transaction)
            .await?;
            sqlx::query(
                "INSERT INTO map_models (map_id, until_events, model) \
                 SELECT $1, until_events, model FROM map_models WHERE map_id = $2",
            )
            .bind(map)
            .bind(base.id)
            .execute(&mut **transaction)
            .await?;
            sqlx::query("INSERT INTO labels (map_id, place, label) SELECT $1, place, label FROM labels WHERE map_id = $2")
                .bind(map)
                .bind(base.id)
                .execute(&mut **transaction)
                .await?;
            Ok(map)
        })
        .await
    }

    /// Copies log events of a base with their sessions, as they are.
    pub(crate) async fn copy_log(
        &self,
        base: MapId,
        map: MapId,
        positions: std::ops::Range<u64>,
    ) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query(
                "INSERT INTO sessions (map_id, number, name, camera, opened_ns, merge, owner) \
                 SELECT $1, number, name, camera, opened_ns, merge, owner FROM sessions \
                 WHERE map_id = $2 AND number IN \
                 (SELECT session FROM log WHERE map_id = $2 AND position >= $3 AND position < $4) \
                 ON CONFLICT DO NOTHING",
            )
            .bind(map)
            .bind(base)
            .bind(to_sql(positions.start))
            .bind(to_sql(positions.end))
            .execute(&mut **transaction)
            .await?;
            const REST: &str = "position, session, sequence, stamp_ns, reason, place, posterior, matched_frame, \
                                probability, link_from, link_to, event, checksum, chain";
            let copy = format!(
                "INSERT INTO log (map_id, {REST}) SELECT $1, {REST} FROM log \
                 WHERE map_id = $2 AND position >= $3 AND position < $4"
            );
            sqlx::query(sqlx::AssertSqlSafe(copy))
                .bind(map)
                .bind(base)
                .bind(to_sql(positions.start))
                .bind(to_sql(positions.end))
                .execute(&mut **transaction)
                .await?;
            Ok(())
        })
        .await
    }

    /// Copies what a source keeps of its frames to the same frames of a target, `from` positions later.
    pub(crate) async fn copy_media(
        &self,
        source: MapId,
        map: MapId,
        positions: std::ops::Range<u64>,
        from: u64,
    ) -> Result<(), StorageError> {
        self.write(async |transaction| copy_media(transaction, source, map, positions, from).await).await
    }

    /// Adds the sessions of a source, and what its places are called, before its events.
    pub(crate) async fn add_joined_sessions(
        &self,
        map: MapId,
        log: &JoinedLog,
        merge: u64,
    ) -> Result<(), StorageError> {
        self.write(async |transaction| insert_sessions_and_labels(transaction, map, log, merge).await).await
    }

    /// Shows a map that holds several, and ends merge and job: all or nothing. [`StorageError::Retold`] if one of those
    /// it was made of was rewritten or deleted since it was read.
    pub(crate) async fn finish_merged_map(
        &self,
        map: MapId,
        made_of: &[MapEdition],
        outcome: &MergeOutcome,
        end: &JobEnd,
    ) -> Result<(), StorageError> {
        self.write_counted(async |transaction| {
            for &edition in made_of {
                check_edition(transaction, edition).await?;
            }
            count_sessions(transaction, map).await?;
            sqlx::query("UPDATE maps SET state = 'live' WHERE id = $1 AND state = 'importing'")
                .bind(map)
                .execute(&mut **transaction)
                .await?;
            commit(transaction, map, outcome, end).await
        })
        .await
    }

    /// Takes out of sight the map that a merge has made, and ends merge and job: all or nothing.
    pub(crate) async fn undo_merged_map(
        &self,
        map: MapId,
        outcome: &MergeOutcome,
        end: &JobEnd,
    ) -> Result<(), StorageError> {
        self.write_counted(async |transaction| {
            sqlx::query(
                "UPDATE maps SET name = '~' || id, state = 'deleting' WHERE id = $1 AND state = 'live'",
            )
            .bind(map)
            .execute(&mut **transaction)
            .await?;
            set_outcome(transaction, outcome, MergeState::Committed).await?;
            end_job(transaction, end).await
        })
        .await
    }
}

async fn commit(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    outcome: &MergeOutcome,
    end: &JobEnd,
) -> Result<(), StorageError> {
    sqlx::query("UPDATE merges SET map_id = $1 WHERE number = $2")
        .bind(map)
        .bind(to_sql(outcome.number))
        .execute(&mut **transaction)
        .await?;
    set_outcome(transaction, outcome, MergeState::Proposed).await?;
    end_job(transaction, end).await
}

/// [`StorageError::JobEnded`] unless the merge was `before`: what was discarded meanwhile must not come about.
pub(super) async fn set_outcome(
    transaction: &mut Transaction<'_, Any>,
    outcome: &MergeOutcome,
    before: MergeState,
) -> Result<(), StorageError> {
    let MergeOutcome { number, state, report } = outcome;
    let done = sqlx::query("UPDATE merges SET state = $1, report = $2 WHERE number = $3 AND state = $4")
        .bind(state)
        .bind(report)
        .bind(to_sql(*number))
        .bind(before)
        .execute(&mut **transaction)
        .await?;
    if done.rows_affected() == 1 { Ok(()) } else { Err(StorageError::JobEnded) }
}

async fn insert_sessions_and_labels(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    log: &JoinedLog,
    merge: u64,
) -> Result<(), StorageError> {
    for JoinedSession { of_source, number, name } in &log.sessions {
        sqlx::query(
            "INSERT INTO sessions (map_id, number, name, camera, opened_ns, merge, owner) \
             SELECT $1, $2, $3, camera, opened_ns, $4, owner FROM sessions WHERE map_id = $5 AND number = $6",
        )
        .bind(map)
        .bind(i64::from(*number))
        .bind(name)
        .bind(to_sql(merge))
        .bind(log.source.map)
        .bind(i64::from(*of_source))
        .execute(&mut **transaction)
        .await?;
    }
    let labels = sqlx::query_as("SELECT place, label FROM labels WHERE map_id = $1")
        .bind(log.source.map)
        .fetch_all(&mut **transaction)
        .await?;
    for LabelRow { place, label } in labels {
        let Some(joined) = log.places.get(&place) else { continue };
        // What the target calls a place counts.
        sqlx::query("INSERT INTO labels (map_id, place, label) VALUES ($1, $2, $3) ON CONFLICT DO NOTHING")
            .bind(map)
            .bind(i64::from(joined.number()))
            .bind(label)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}

/// Media and notes.
async fn copy_media(
    transaction: &mut Transaction<'_, Any>,
    source: MapId,
    map: MapId,
    positions: std::ops::Range<u64>,
    from: u64,
) -> Result<(), StorageError> {
    sqlx::query(
        "INSERT INTO frame_media (map_id, position, kind, content, object, object_bytes, object_sha256) \
         SELECT $1, position + $2, kind, content, object, object_bytes, object_sha256 FROM frame_media \
         WHERE map_id = $3 AND position >= $4 AND position < $5",
    )
    .bind(map)
    .bind(to_sql(from))
    .bind(source)
    .bind(to_sql(positions.start))
    .bind(to_sql(positions.end))
    .execute(&mut **transaction)
    .await?;
    copy_notes(transaction, source, map, positions, from).await
}
