use futures::{StreamExt, TryStreamExt};
use sqlx::{Any, Transaction};
use topomap::ids::FrameId;

use super::damage::Where;
use super::media_store::damage;
use super::objects::{AT_ONCE, MOST_IN_ROW, NoObject, ObjectRef, Objects};
use super::values::{from_sql, to_sql, words};
use super::{MapId, Storage, StorageError};
use crate::camera::Camera;

/// Something that a map keeps of a frame beside its words.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Medium {
    pub(crate) kind: MediumKind,
    pub(crate) content: Vec<u8>,
}

/// In the order of their names, which is the order of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum MediumKind {
    /// A [`waypost_vision::feature_record::FeatureRecord`].
    Features,
    /// The image as the robot sent it.
    Image,
    /// A small JPEG.
    Thumbnail,
}

words!(MediumKind { Features = "features", Image = "image", Thumbnail = "thumbnail" });

/// Where a frame's features are, as it is kept.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StoredFeatures {
    /// A [`waypost_vision::feature_record::FeatureRecord`].
    pub(crate) features: Vec<u8>,
    pub(crate) camera: Option<Camera>,
}

/// The content of a medium as its row has it: by itself, or as the name of an object.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(super) struct StoredContent {
    content: Vec<u8>,
    object: Option<String>,
    object_bytes: Option<i64>,
    object_sha256: Option<Vec<u8>>,
}

/// The columns of a [`StoredContent`].
pub(super) const CONTENT: &str = "content, object, object_bytes, object_sha256";

/// A frame's medium.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whose {
    pub(super) map: MapId,
    pub(super) frame: FrameId,
    pub(super) kind: MediumKind,
}

#[derive(sqlx::FromRow)]
struct KindRow {
    kind: MediumKind,
    #[sqlx(flatten)]
    stored: StoredContent,
}

#[derive(sqlx::FromRow)]
struct FeaturesRow {
    #[sqlx(flatten)]
    stored: StoredContent,
    camera: Option<Camera>,
}

/// What a map takes on the disk, and in the store of its media.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct MapBytes {
    #[sqlx(try_from = "i64")]
    pub(crate) log: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) checkpoint: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) features: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) thumbnails: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) images: u64,
}

impl MapBytes {
    /// All of it, divided by the number of frames; 0 if there are none.
    pub(crate) fn per_frame(self, frames: u64) -> f64 {
        let Self { log, checkpoint, features, thumbnails, images } = self;
        match frames {
            0 => 0.0,
            frames => (log + checkpoint + features + thumbnails + images) as f64 / frames as f64,
        }
    }
}

impl Storage {
    /// What is kept of a frame, if it is.
    pub(crate) async fn medium(
        &self,
        map: MapId,
        frame: FrameId,
        kind: MediumKind,
    ) -> Result<Option<Vec<u8>>, StorageError> {
        let select =
            format!("SELECT {CONTENT} FROM frame_media WHERE map_id = $1 AND position = $2 AND kind = $3");
        let query = sqlx::query_as(sqlx::AssertSqlSafe(select)).bind(map).bind(to_sql(frame)).bind(kind);
        let medium = query.fetch_optional(&self.readers).await;
        let medium = self.noting_rot(map, Where::Event(frame), medium.map_err(StorageError::from)).await?;
        let Some(stored) = medium else { return Ok(None) };
        unless_deleted(self.content_of(Whose { map, frame, kind }, stored).await)
    }

    /// Reads all that is kept of a frame beside its words; damage is noted, and given as an error.
    pub(crate) async fn read_media(&self, map: MapId, frame: FrameId) -> Result<(), StorageError> {
        let select = format!("SELECT kind, {CONTENT} FROM frame_media WHERE map_id = $1 AND position = $2");
        let query = sqlx::query_as(sqlx::AssertSqlSafe(select)).bind(map).bind(to_sql(frame));
        let media: Result<Vec<KindRow>, _> = query.fetch_all(&self.readers).await;
        let media = self.noting_rot(map, Where::Event(frame), media.map_err(StorageError::from)).await?;
        for KindRow { kind, stored } in media {
            unless_deleted(self.content_of(Whose { map, frame, kind }, stored).await)?;
        }
        Ok(())
    }

    /// Where a frame's features are, if that is kept, with the camera that its session declared.
    pub(crate) async fn features(
        &self,
        map: MapId,
        frame: FrameId,
    ) -> Result<Option<StoredFeatures>, StorageError> {
        let features = sqlx::query_as(
            "SELECT m.content, m.object, m.object_bytes, m.object_sha256, s.camera FROM frame_media AS m \
             JOIN log AS l ON l.map_id = m.map_id AND l.position = m.position \
             JOIN sessions AS s ON s.map_id = l.map_id AND s.number = l.session \
             WHERE m.map_id = $1 AND m.position = $2 AND m.kind = 'features'",
        )
        .bind(map)
        .bind(to_sql(frame))
        .fetch_optional(&self.readers)
        .await;
        let features = features.map_err(StorageError::from);
        let features: Option<FeaturesRow> = self.noting_rot(map, Where::Event(frame), features).await?;
        let Some(FeaturesRow { stored, camera }) = features else { return Ok(None) };
        let whose = Whose { map, frame, kind: MediumKind::Features };
        let features = unless_deleted(self.content_of(whose, stored).await)?;
        Ok(features.map(|features| StoredFeatures { features, camera }))
    }

    /// The content of a medium whose row was read. [`StorageError::Retold`] if it was deleted since; damage is noted.
    pub(super) async fn content_of(
        &self,
        whose: Whose,
        stored: StoredContent,
    ) -> Result<Vec<u8>, StorageError> {
        let object = match stored.object()? {
            Ok(content) => return Ok(content),
            Err(object) => object,
        };
        let Some(objects) = &self.objects else {
            return Err(StorageError::Unfit(
                "media of this database are not in it; say where with --media (WAYPOST_MEDIA, or media in the file)"
                    .to_owned(),
            ));
        };
        let found = match objects.get(&object).await {
            Ok(content) => return Ok(content),
            Err(NoObject::Failed(error)) => return Err(error),
            Err(found @ (NoObject::Gone | NoObject::Another)) => found,
        };
        let Whose { map, frame, kind } = whose;
        let there = sqlx::query_scalar(
            "SELECT count(*) FROM frame_media WHERE map_id = $1 AND position = $2 AND kind = $3 AND object = $4",
        );
        let there = there.bind(map).bind(to_sql(frame)).bind(kind).bind(&object.name);
        let there: i64 = there.fetch_one(&self.readers).await?;
        if there == 0 {
            return Err(StorageError::Retold);
        }
        self.noting_rot(map, Where::Event(frame), Err(StorageError::Rot(damage(&object, &found)))).await
    }

    /// Puts outside the database what goes there of some media; for each, its object if it is there.
    pub(super) async fn put_outside(
        &self,
        map: MapId,
        contents: &[&[u8]],
    ) -> Result<Vec<Option<ObjectRef>>, StorageError> {
        let Some(objects) = &self.objects else { return Ok(vec![None; contents.len()]) };
        let puts: Vec<_> = contents.iter().map(|content| put(objects, map, content)).collect();
        futures::stream::iter(puts).buffered(AT_ONCE).try_collect().await
    }

    /// Adds up what a map takes. SQLite knows the length of a blob without reading it.
    pub(crate) async fn map_bytes(&self, map: MapId) -> Result<MapBytes, StorageError> {
        Ok(sqlx::query_as(
            "SELECT (SELECT coalesce(sum(length(event)), 0) FROM log WHERE map_id = $1) AS log, \
             (SELECT coalesce(sum(length(head)), 0) FROM checkpoints WHERE map_id = $1) + \
             (SELECT coalesce(sum(length(content)), 0) FROM checkpoint_sessions WHERE map_id = $1) + \
             (SELECT coalesce(sum(length(content)), 0) FROM checkpoint_links WHERE map_id = $1) + \
             (SELECT coalesce(sum(length(content)), 0) FROM checkpoint_blocks WHERE map_id = $1) + \
             (SELECT coalesce(sum(length(content)), 0) FROM checkpoint_places WHERE map_id = $1) AS checkpoint, \
             (SELECT CAST(coalesce(sum(coalesce(object_bytes, length(content))), 0) AS BIGINT) FROM frame_media \
             WHERE map_id = $1 AND kind = 'features') AS features, \
             (SELECT CAST(coalesce(sum(coalesce(object_bytes, length(content))), 0) AS BIGINT) FROM frame_media \
             WHERE map_id = $1 AND kind = 'thumbnail') AS thumbnails, \
             (SELECT CAST(coalesce(sum(coalesce(object_bytes, length(content))), 0) AS BIGINT) FROM frame_media \
             WHERE map_id = $1 AND kind = 'image') AS images",
        )
        .bind(map)
        .fetch_one(&self.readers)
        .await?)
    }
}

/// What is kept by these.
pub(crate) fn kept_bytes(media: &[Medium]) -> u64 {
    media.iter().map(|medium| medium.content.len() as u64).sum()
}

async fn put(objects: &Objects, map: MapId, content: &[u8]) -> Result<Option<ObjectRef>, StorageError> {
    if content.len() <= MOST_IN_ROW { Ok(None) } else { objects.put(map, content).await.map(Some) }
}

/// What was deleted since its row was read is as if it were asked for now: not there.
fn unless_deleted(content: Result<Vec<u8>, StorageError>) -> Result<Option<Vec<u8>>, StorageError> {
    match content {
        Err(StorageError::Retold) => Ok(None),
        content => content.map(Some),
    }
}

impl StoredContent {
    /// The content, or which object has it.
    fn object(self) -> Result<Result<Vec<u8>, ObjectRef>, StorageError> {
        let Self { content, object, object_bytes, object_sha256 } = self;
        match (object, object_bytes, object_sha256) {
            (Some(name), Some(bytes), Some(sha256)) => {
                Ok(Err(ObjectRef { name, bytes: from_sql(bytes)?, sha256 }))
            }
            (None, None, None) => Ok(Ok(content)),
            // An object of which something is missing cannot be told from another.
            (None | Some(_), None | Some(_), None | Some(_)) => {
                Err(StorageError::Damaged("a medium that names a part of an object".to_owned()))
            }
        }
    }
}

/// Stores a medium of a frame: its content, or the name of its object.
pub(super) async fn insert_medium(
    transaction: &mut Transaction<'_, Any>,
    Whose { map, frame, kind }: Whose,
    content: &[u8],
    object: Option<&ObjectRef>,
) -> Result<(), StorageError> {
    sqlx::query(
        "INSERT INTO frame_media (map_id, position, kind, content, object, object_bytes, object_sha256) \
         VALUES ($1, $2, $3, $4, $5, $6, $7)",
    )
    .bind(map)
    .bind(to_sql(frame))
    .bind(kind)
    .bind(if object.is_some() { &[] } else { content })
    .bind(object.map(|object| object.name.as_str()))
    .bind(object.map(|object| object.bytes as i64))
    .bind(object.map(|object| object.sha256.as_slice()))
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
