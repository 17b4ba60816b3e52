use sqlx::{Any, Transaction};
use topomap::ids::SessionId;
use topomap::log::MapEvent;

use super::new_events::{NewEvent, insert_events};
use super::values::{from_sql, to_sql};
use super::{Storage, StorageError};
use crate::camera::Camera;
use crate::quotas::Used;

/// Number of a map in the database; never used twice.
pub(crate) type MapId = i64;

#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct MapRow {
    pub(crate) id: MapId,
    pub(crate) name: String,
    /// Hash of its model.
    pub(crate) model: String,
    /// JSON.
    pub(crate) settings: String,
    pub(crate) created_ns: i64,
    /// How often its log was rewritten.
    #[sqlx(try_from = "i64")]
    pub(crate) edition: u64,
}

/// A map at some edition: what was read of it holds for no other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MapEdition {
    pub(crate) map: MapId,
    pub(crate) edition: u64,
}

#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct SessionRow {
    #[sqlx(try_from = "i64")]
    pub(crate) number: SessionId,
    pub(crate) name: String,
    /// Name of the token that opened it, if one did.
    pub(crate) owner: Option<String>,
}

/// What a map holds, by its log.
#[derive(Clone, Copy, Debug, Default, PartialEq, sqlx::FromRow)]
pub(crate) struct MapCounts {
    #[sqlx(try_from = "i64")]
    pub(crate) sessions: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) frames: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) loop_closures: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) places: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) links: u64,
}

impl MapRow {
    pub(crate) fn edition(&self) -> MapEdition {
        MapEdition { map: self.id, edition: self.edition }
    }
}

impl Storage {
    /// Makes a map that counts for the quota of `owner`, a token.
    pub(crate) async fn create_map(
        &self,
        name: &str,
        model: &str,
        settings: &str,
        created_ns: i64,
        owner: Option<&str>,
    ) -> Result<MapRow, StorageError> {
        self.quotas.check_map(owner)?;
        let created = self.write_counted(async |transaction| {
            // Once more: another may have been made meanwhile.
            self.quotas.check_map(owner)?;
            let insert = "INSERT INTO maps (name, model, settings, created_ns, owner) VALUES ($1, $2, $3, $4, $5) RETURNING id";
            let id = sqlx::query_scalar(insert)
                .bind(name)
                .bind(model)
                .bind(settings)
                .bind(created_ns)
                .bind(owner)
                .fetch_one(&mut **transaction)
                .await?;
            Ok(id)
        });
        let id = created.await?;
        let name = name.to_owned();
        let model = model.to_owned();
        let settings = settings.to_owned();
        Ok(MapRow { id, name, model, settings, created_ns, edition: 0 })
    }

    pub(crate) async fn map(&self, name: &str) -> Result<Option<MapRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT id, name, model, settings, created_ns, edition FROM maps WHERE name = $1 AND state = 'live'",
        )
        .bind(name)
        .fetch_optional(&self.readers)
        .await?)
    }

    /// Maps whose name comes after `after`, by name.
    pub(crate) async fn maps(&self, after: &str, limit: u32) -> Result<Vec<MapRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT id, name, model, settings, created_ns, edition FROM maps \
             WHERE name > $1 AND state = 'live' ORDER BY name LIMIT $2",
        )
        .bind(after)
        .bind(i64::from(limit))
        .fetch_all(&self.readers)
        .await?)
    }

    pub(crate) async fn map_counts(&self, map: MapId) -> Result<MapCounts, StorageError> {
        Ok(sqlx::query_as(
            "SELECT (SELECT count(*) FROM sessions WHERE map_id = $1) AS sessions, \
             (SELECT count(*) FROM log WHERE map_id = $1 AND sequence IS NOT NULL) AS frames, \
             (SELECT count(*) FROM log WHERE map_id = $1 AND reason = 'loop_closure') AS loop_closures, \
             (SELECT coalesce(max(place) + 1, 0) FROM log WHERE map_id = $1 AND place IS NOT NULL) AS places, \
             (SELECT count(*) FROM log WHERE map_id = $1 AND link_to IS NOT NULL) AS links",
        )
        .bind(map)
        .fetch_one(&self.readers)
        .await?)
    }

    /// Binds a map to another model, noting which one it had up to now.
    pub(crate) async fn rebind_map(&self, map: MapId, model: &str) -> Result<(), StorageError> {
        self.check_sound(map)?;
        self.write(async |transaction| {
            sqlx::query(
                "INSERT INTO map_models (map_id, until_events, model) \
                 SELECT id, (SELECT coalesce(max(position) + 1, 0) FROM log WHERE map_id = $1), model FROM maps \
                 WHERE id = $1 ON CONFLICT DO NOTHING",
            )
            .bind(map)
            .execute(&mut **transaction)
            .await?;
            sqlx::query("UPDATE maps SET model = $1 WHERE id = $2")
                .bind(model)
                .bind(map)
                .execute(&mut **transaction)
                .await?;
            Ok(())
        })
        .await
    }

    /// The model that a map had when the event at `position` was decided, if it has another now.
    pub(crate) async fn former_model(
        &self,
        map: MapId,
        position: u64,
    ) -> Result<Option<String>, StorageError> {
        Ok(sqlx::query_scalar(
            "SELECT model FROM map_models WHERE map_id = $1 AND until_events > $2 ORDER BY until_events LIMIT 1",
        )
        .bind(map)
        .bind(to_sql(position))
        .fetch_optional(&self.readers)
        .await?)
    }

    /// All sessions of a map, by number.
    pub(crate) async fn sessions(&self, map: MapId) -> Result<Vec<SessionRow>, StorageError> {
        Ok(sqlx::query_as("SELECT number, name, owner FROM sessions WHERE map_id = $1 ORDER BY number")
            .bind(map)
            .fetch_all(&self.readers)
            .await?)
    }

    /// The cameras that sessions declared.
    pub(crate) async fn cameras(&self, map: MapId) -> Result<Vec<(SessionId, Camera)>, StorageError> {
        let cameras: Vec<(i64, Camera)> =
            sqlx::query_as("SELECT number, camera FROM sessions WHERE map_id = $1 AND camera IS NOT NULL")
                .bind(map)
                .fetch_all(&self.readers)
                .await?;
        cameras.into_iter().map(|(session, camera)| Ok((from_sql(session)?, camera))).collect()
    }

    /// The camera that a session declared.
    pub(crate) async fn session_camera(
        &self,
        map: MapId,
        session: &str,
    ) -> Result<Option<Camera>, StorageError> {
        let camera: Option<Option<Camera>> =
            sqlx::query_scalar("SELECT camera FROM sessions WHERE map_id = $1 AND name = $2")
                .bind(map)
                .bind(session)
                .fetch_optional(&self.readers)
                .await?;
        Ok(camera.flatten())
    }

    /// Adds a session and its event at `position` of the map's log, in one transaction.
    pub(crate) async fn open_session(
        &self,
        map: MapId,
        position: u64,
        session: &SessionRow,
        camera: Option<&Camera>,
        opened_ns: i64,
    ) -> Result<(), StorageError> {
        self.check_sound(map)?;
        let owner = session.owner.as_deref();
        self.quotas.check_session(owner)?;
        let open = async |transaction: &mut Transaction<'_, Any>| {
            // Once more: another may have been opened meanwhile.
            self.quotas.check_session(owner)?;
            let event = MapEvent::SessionOpened { session: session.number };
            let opened = insert_events(transaction, &[NewEvent { map, position, event: &event }]).await?;
            let kept_bytes: u64 = opened.iter().sum();
            sqlx::query(
                "INSERT INTO sessions (map_id, number, name, camera, opened_ns, owner, kept_bytes) \
                 VALUES ($1, $2, $3, $4, $5, $6, $7)",
            )
            .bind(map)
            .bind(i64::from(session.number))
            .bind(&session.name)
            .bind(camera)
            .bind(opened_ns)
            .bind(owner)
            .bind(to_sql(kept_bytes))
            .execute(&mut **transaction)
            .await?;
            Ok(kept_bytes)
        };
        let opened = self.write_and(open, async |_, kept_bytes| {
            self.quotas.add(owner, Used { maps: 0, sessions: 1, kept_bytes: *kept_bytes });
        });
        opened.await.map(drop)
    }
}

/// [`StorageError::Retold`] if the log was rewritten since, or the map deleted.
pub(super) async fn check_edition(
    transaction: &mut Transaction<'_, Any>,
    MapEdition { map, edition }: MapEdition,
) -> Result<(), StorageError> {
    let row = sqlx::query("SELECT 1 FROM maps WHERE id = $1 AND edition = $2 AND state = 'live'")
        .bind(map)
        .bind(to_sql(edition))
        .fetch_optional(&mut **transaction)
        .await?;
    if row.is_some() { Ok(()) } else { Err(StorageError::Retold) }
}
