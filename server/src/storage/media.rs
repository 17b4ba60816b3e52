use sqlx::{Any, Transaction};
use topomap::ids::FrameId;

use super::damage::Where;
use super::values::{to_sql, words};
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
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct StoredFeatures {
    /// A [`waypost_vision::feature_record::FeatureRecord`].
    pub(crate) features: Vec<u8>,
    pub(crate) camera: Option<Camera>,
}

/// What a map takes on the disk.
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
        let select = "SELECT content FROM frame_media WHERE map_id = $1 AND position = $2 AND kind = $3";
        let query = sqlx::query_scalar(select).bind(map).bind(to_sql(frame)).bind(kind);
        let medium = query.fetch_optional(&self.readers).await;
        self.noting_rot(map, Where::Event(frame), medium.map_err(StorageError::from)).await
    }

    /// Reads all that is kept of a frame beside its words; damage is noted, and given as an error.
    pub(crate) async fn read_media(&self, map: MapId, frame: FrameId) -> Result<(), StorageError> {
        let select = "SELECT content FROM frame_media WHERE map_id = $1 AND position = $2";
        let query = sqlx::query_scalar(select).bind(map).bind(to_sql(frame));
        let media: Result<Vec<Vec<u8>>, _> = query.fetch_all(&self.readers).await;
        self.noting_rot(map, Where::Event(frame), media.map(drop).map_err(StorageError::from)).await
    }

    /// Where a frame's features are, if that is kept, with the camera that its session declared.
    pub(crate) async fn features(
        &self,
        map: MapId,
        frame: FrameId,
    ) -> Result<Option<StoredFeatures>, StorageError> {
        let features = sqlx::query_as(
            "SELECT m.content AS features, s.camera FROM frame_media AS m \
             JOIN log AS l ON l.map_id = m.map_id AND l.position = m.position \
             JOIN sessions AS s ON s.map_id = l.map_id AND s.number = l.session \
             WHERE m.map_id = $1 AND m.position = $2 AND m.kind = 'features'",
        )
        .bind(map)
        .bind(to_sql(frame))
        .fetch_optional(&self.readers)
        .await;
        self.noting_rot(map, Where::Event(frame), features.map_err(StorageError::from)).await
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
             (SELECT coalesce(sum(length(content)), 0) FROM frame_media WHERE map_id = $1 AND kind = 'features') AS features, \
             (SELECT coalesce(sum(length(content)), 0) FROM frame_media WHERE map_id = $1 AND kind = 'thumbnail') AS thumbnails, \
             (SELECT coalesce(sum(length(content)), 0) FROM frame_media WHERE map_id = $1 AND kind = 'image') AS images",
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

pub(super) async fn insert_media(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    position: i64,
    media: &[Medium],
) -> Result<(), StorageError> {
    for Medium { kind, content } in media {
        sqlx::query("INSERT INTO frame_media (map_id, position, kind, content) VALUES ($1, $2, $3, $4)")
            .bind(map)
            .bind(position)
            .bind(kind)
            .bind(content)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}
