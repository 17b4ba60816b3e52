//! Maps read out as they stand, and brought in piece by piece.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use sqlx::{Any, Transaction};
use topomap::ids::SessionId;
use topomap::log::MapEvent;

use super::damage::Where;
use super::jobs::end_job;
use super::labels::insert_label;
use super::media::{CONTENT, StoredContent, Whose, insert_medium};
use super::new_events::{NewEvent, insert_events};
use super::notes::insert_note;
use super::row_sums::{CHAIN_START, StoredEvent};
use super::values::to_sql;
use super::{JobEnd, LabelRow, MapId, MapRow, MediumKind, ModelRow, NoteRow, Storage, StorageError};
use crate::camera::Camera;

/// Log events that are read at a time.
const EVENTS_PAGE: u32 = 500;

/// Media that are read at a time: they may be whole images.
const MEDIA_PAGE: u32 = 8;

/// Labels that are read at a time.
const LABELS_PAGE: u32 = 500;

/// Notes of frames that are read at a time.
const NOTES_PAGE: u32 = 500;

/// A session with all that is stored of it.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct StoredSession {
    #[sqlx(try_from = "i64")]
    pub(crate) number: SessionId,
    pub(crate) name: String,
    pub(crate) camera: Option<Camera>,
    pub(crate) opened_ns: i64,
}

/// A model that a map was bound to before.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct FormerModelRow {
    /// The log position from which it no longer was.
    #[sqlx(try_from = "i64")]
    pub(crate) until_events: u64,
    /// Its hash.
    pub(crate) model: String,
}

/// What a map keeps of a frame beside its words.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MediaRow {
    /// The frame's position in the log.
    pub(crate) position: u64,
    pub(crate) kind: MediumKind,
    pub(crate) content: Vec<u8>,
}

#[derive(sqlx::FromRow)]
struct StoredMedium {
    #[sqlx(try_from = "i64")]
    position: u64,
    kind: MediumKind,
    #[sqlx(flatten)]
    stored: StoredContent,
}

/// A map that is to be brought in, without its log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ImportedMap {
    pub(crate) name: String,
    pub(crate) model: ModelRow,
    pub(crate) model_file: Vec<u8>,
    /// JSON.
    pub(crate) settings: String,
    pub(crate) created_ns: i64,
    pub(crate) former_models: Vec<FormerModelRow>,
    pub(crate) sessions: Vec<StoredSession>,
    /// What each of them keeps.
    pub(crate) kept: BTreeMap<SessionId, u64>,
}

/// One consistent view of a map, whatever is written meanwhile. Holds one of a few connections.
#[derive(Debug)]
pub(crate) struct MapView {
    map: MapRow,
    snapshot: Transaction<'static, Any>,
    storage: Storage,
    /// The next event of the log, and the link of the one before it.
    next: (u64, i64),
}

impl Storage {
    /// A view of the map of that name as it is now.
    pub(crate) async fn view_map(&self, name: &str) -> Result<Option<MapView>, StorageError> {
        let mut snapshot = self.snapshot(&self.exporters).await?;
        // The first read is what fixes the view.
        let map = sqlx::query_as(
            "SELECT id, name, model, settings, created_ns, edition FROM maps WHERE name = $1 AND state = 'live'",
        )
        .bind(name)
        .fetch_optional(&mut *snapshot)
        .await?;
        let Some::<MapRow>(map) = map else { return Ok(None) };
        let storage = self.clone();
        Ok(Some(MapView { map, snapshot, storage, next: (0, CHAIN_START) }))
    }

    /// Begins an import: a map that nobody sees yet, with its sessions, and its model unless that is
    /// there. [`StorageError::Exists`] if the name is taken. Says in the job's row which model it brought.
    /// The map counts for the quota of `owner`, a token.
    pub(crate) async fn begin_import(
        &self,
        map: &ImportedMap,
        owner: Option<&str>,
        job: u64,
    ) -> Result<MapId, StorageError> {
        let ImportedMap { name, model, model_file, settings, created_ns, former_models, sessions, kept } =
            map;
        self.write_counted(async |transaction| {
            self.quotas.check_map(owner)?;
            self.quotas.check_copies(sessions.len() as u64, kept.values().sum())?;
            if super::models::insert_model(transaction, model, model_file).await? {
                sqlx::query("UPDATE jobs SET result = 'models/' || $1 WHERE number = $2")
                    .bind(&model.hash)
                    .bind(to_sql(job))
                    .execute(&mut **transaction)
                    .await?;
            }
            let map = sqlx::query_scalar(
                "INSERT INTO maps (name, model, settings, created_ns, state, owner) \
                 VALUES ($1, $2, $3, $4, 'importing', $5) RETURNING id",
            )
            .bind(name)
            .bind(&model.hash)
            .bind(settings)
            .bind(created_ns)
            .bind(owner)
            .fetch_one(&mut **transaction)
            .await?;
            for FormerModelRow { until_events, model } in former_models {
                sqlx::query("INSERT INTO map_models (map_id, until_events, model) VALUES ($1, $2, $3)")
                    .bind(map)
                    .bind(to_sql(*until_events))
                    .bind(model)
                    .execute(&mut **transaction)
                    .await?;
            }
            for StoredSession { number, name, camera, opened_ns } in sessions {
                sqlx::query(
                    "INSERT INTO sessions (map_id, number, name, camera, opened_ns, kept_bytes) VALUES ($1, $2, $3, $4, $5, $6)",
                )
                .bind(map)
                .bind(i64::from(*number))
                .bind(name)
                .bind(camera)
                .bind(opened_ns)
                .bind(to_sql(kept.get(number).copied().unwrap_or_default()))
                .execute(&mut **transaction)
                .await?;
            }
            Ok(map)
        })
        .await
    }

    /// Adds a piece of an import.
    pub(crate) async fn import_piece(
        &self,
        map: MapId,
        events: &[(u64, MapEvent)],
        media: &[MediaRow],
        labels: &[LabelRow],
        notes: &[NoteRow],
    ) -> Result<(), StorageError> {
        let contents: Vec<&[u8]> = media.iter().map(|medium| medium.content.as_slice()).collect();
        let objects = self.put_outside(map, &contents).await?;
        self.write(async |transaction| {
            let events: Vec<NewEvent<'_>> =
                events.iter().map(|(position, event)| NewEvent { map, position: *position, event }).collect();
            insert_events(transaction, &events).await?;
            for (MediaRow { position, kind, content }, object) in media.iter().zip(&objects) {
                let whose = Whose { map, frame: *position, kind: *kind };
                insert_medium(transaction, whose, content, object.as_ref()).await?;
            }
            for LabelRow { place, label } in labels {
                insert_label(transaction, map, *place, label).await?;
            }
            for NoteRow { position, note } in notes {
                insert_note(transaction, map, to_sql(*position), note).await?;
            }
            Ok(())
        })
        .await
    }

    /// Shows an imported map, and ends its job: both or neither.
    pub(crate) async fn finish_import(&self, map: MapId, end: &JobEnd) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query("UPDATE maps SET state = 'live' WHERE id = $1 AND state = 'importing'")
                .bind(map)
                .execute(&mut **transaction)
                .await?;
            end_job(transaction, end).await
        })
        .await
    }
}

impl MapView {
    pub(crate) fn map(&self) -> &MapRow {
        &self.map
    }

    /// The model's display name and file.
    pub(crate) async fn model(&mut self) -> Result<(String, Vec<u8>), StorageError> {
        Ok(sqlx::query_as("SELECT display_name, file FROM models WHERE hash = $1")
            .bind(&self.map.model)
            .fetch_one(&mut *self.snapshot)
            .await?)
    }

    pub(crate) async fn former_models(&mut self) -> Result<Vec<FormerModelRow>, StorageError> {
        let rows = sqlx::query_as(
            "SELECT until_events, model FROM map_models WHERE map_id = $1 ORDER BY until_events",
        )
        .bind(self.map.id)
        .fetch_all(&mut *self.snapshot)
        .await;
        self.noting_rot(Where::Somewhere, rows.map_err(StorageError::from)).await
    }

    pub(crate) async fn sessions(&mut self) -> Result<Vec<StoredSession>, StorageError> {
        let rows = sqlx::query_as(
            "SELECT number, name, camera, opened_ns FROM sessions WHERE map_id = $1 ORDER BY number",
        )
        .bind(self.map.id)
        .fetch_all(&mut *self.snapshot)
        .await;
        self.noting_rot(Where::Somewhere, rows.map_err(StorageError::from)).await
    }

    /// The next events as they are stored; none at the end of the log. [`StorageError::Rot`] if one is not as it was
    /// written: what leaves here gets a checksum that says it is whole.
    pub(crate) async fn events(&mut self) -> Result<Vec<(u64, Vec<u8>)>, StorageError> {
        let (from, mut chain) = self.next;
        let stored: Result<Vec<StoredEvent>, _> = sqlx::query_as(
            "SELECT position, event, checksum, chain FROM log WHERE map_id = $1 AND position >= $2 \
             ORDER BY position LIMIT $3",
        )
        .bind(self.map.id)
        .bind(to_sql(from))
        .bind(i64::from(EVENTS_PAGE))
        .fetch_all(&mut *self.snapshot)
        .await;
        let stored = self.noting_rot(Where::Somewhere, stored.map_err(StorageError::from)).await?;
        let mut events = Vec::with_capacity(stored.len());
        for (position, stored) in (from..).zip(stored) {
            let link = stored.follow(position, chain);
            chain = self.noting_rot(Where::Event(position), link).await?;
            events.push((position, stored.bytes));
        }
        self.next = (from + events.len() as u64, chain);
        Ok(events)
    }

    async fn noting_rot<T>(&self, place: Where, read: Result<T, StorageError>) -> Result<T, StorageError> {
        self.storage.noting_rot(self.map.id, place, read).await
    }

    /// The next media after that of a position and kind; none after the last.
    pub(crate) async fn media(
        &mut self,
        after: Option<(u64, MediumKind)>,
    ) -> Result<Vec<MediaRow>, StorageError> {
        let first = (-1, MediumKind::Features);
        let (position, kind) = after.map_or(first, |(position, kind)| (to_sql(position), kind));
        let select = format!(
            "SELECT position, kind, {CONTENT} FROM frame_media WHERE map_id = $1 AND (position, kind) > ($2, $3) \
             ORDER BY position, kind LIMIT $4"
        );
        let media = sqlx::query_as(sqlx::AssertSqlSafe(select))
            .bind(self.map.id)
            .bind(position)
            .bind(kind)
            .bind(i64::from(MEDIA_PAGE))
            .fetch_all(&mut *self.snapshot)
            .await;
        // Several are read at once: which of them it is, nobody can say here.
        let media: Vec<StoredMedium> =
            self.noting_rot(Where::Somewhere, media.map_err(StorageError::from)).await?;
        let contents = media.into_iter().map(async |StoredMedium { position, kind, stored }| {
            let whose = Whose { map: self.map.id, frame: position, kind };
            let content = self.storage.content_of(whose, stored).await?;
            Ok(MediaRow { position, kind, content })
        });
        futures::future::try_join_all(contents).await
    }

    /// The next labels, from that of a place on; none after the last.
    pub(crate) async fn labels(&mut self, from: PlaceId) -> Result<Vec<LabelRow>, StorageError> {
        let rows = sqlx::query_as(
            // One that was put while places were renumbered may be of none.
            "SELECT place, label FROM labels WHERE map_id = $1 AND place >= $2 \
             AND EXISTS (SELECT 1 FROM log WHERE log.map_id = labels.map_id AND log.place = labels.place) \
             ORDER BY place LIMIT $3",
        )
        .bind(self.map.id)
        .bind(i64::from(from.number()))
        .bind(i64::from(LABELS_PAGE))
        .fetch_all(&mut *self.snapshot)
        .await;
        self.noting_rot(Where::Somewhere, rows.map_err(StorageError::from)).await
    }

    /// The next notes, from that of a frame on; none after the last.
    pub(crate) async fn notes(&mut self, from: u64) -> Result<Vec<NoteRow>, StorageError> {
        let rows = sqlx::query_as(
            "SELECT position, note FROM frame_notes WHERE map_id = $1 AND position >= $2 ORDER BY position LIMIT $3",
        )
        .bind(self.map.id)
        .bind(to_sql(from))
        .bind(i64::from(NOTES_PAGE))
        .fetch_all(&mut *self.snapshot)
        .await;
        self.noting_rot(Where::Somewhere, rows.map_err(StorageError::from)).await
    }
}
