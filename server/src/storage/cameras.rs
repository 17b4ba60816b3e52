//! Cameras as a column keeps them, and those that earlier servers kept as messages.

use sqlx::any::{AnyTypeInfo, AnyValueRef};
use sqlx::encode::IsNull;
use sqlx::error::BoxDynError;
use sqlx::{Any, Database, Decode, Encode, Type};

use super::{MapId, Storage, StorageError};
use crate::camera::{Camera, from_message};

impl Type<Any> for Camera {
    fn type_info() -> AnyTypeInfo {
        <Vec<u8> as Type<Any>>::type_info()
    }
}

impl<'row> Decode<'row, Any> for Camera {
    fn decode(value: AnyValueRef<'row>) -> Result<Self, BoxDynError> {
        Ok(Camera::from_bytes(<&[u8] as Decode<Any>>::decode(value)?)?)
    }
}

impl Encode<'_, Any> for Camera {
    fn encode_by_ref(&self, buffer: &mut <Any as Database>::ArgumentBuffer) -> Result<IsNull, BoxDynError> {
        Encode::<Any>::encode(self.to_bytes(), buffer)
    }
}

impl Storage {
    /// Gives cameras that were kept as messages their present byte form. One that is no camera stays as it is: its
    /// session then has none.
    pub(super) async fn rewrite_camera_messages(&self) -> Result<(), StorageError> {
        self.write(async |transaction| {
            let kept: Vec<(MapId, i64, Vec<u8>)> = sqlx::query_as(
                "SELECT map_id, number, camera_message FROM sessions WHERE camera_message IS NOT NULL",
            )
            .fetch_all(&mut **transaction)
            .await?;
            for (map, session, message) in kept {
                let Some(camera) = from_message(&message) else {
                    tracing::error!(map, session, "the camera of a session cannot be read; it is left out");
                    continue;
                };
                sqlx::query(
                    "UPDATE sessions SET camera = $1, camera_message = NULL WHERE map_id = $2 AND number = $3",
                )
                .bind(camera)
                .bind(map)
                .bind(session)
                .execute(&mut **transaction)
                .await?;
            }
            Ok(())
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;

    /// A field of view of half a radian, as the message that servers kept before.
    const MESSAGE: [u8; 11] = [0x12, 9, 9, 0, 0, 0, 0, 0, 0, 0xe0, 0x3f];

    #[tokio::test]
    async fn cameras_that_earlier_servers_kept_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let storage = Storage::open(directory.path()).await.unwrap();
        let statements = [
            "INSERT INTO models (hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns, file) \
             VALUES ('m', '', '', 1, 0, 'w', 1, 1, x'00')",
            "INSERT INTO maps (id, name, model, settings, created_ns) VALUES (1, 'hall', 'm', '{}', 1)",
            "INSERT INTO sessions (map_id, number, name, camera_message, opened_ns) \
             VALUES (1, 0, 'first', x'120909000000000000e03f', 1), (1, 1, 'second', NULL, 1), (1, 2, 'third', x'57', 1)",
        ];
        for statement in statements {
            sqlx::query(statement).execute(&storage.writer).await.unwrap();
        }
        storage.close().await;
        let storage = Storage::open(directory.path()).await.unwrap();
        let camera = Camera {
            model: Some(CameraModel::FieldOfView { horizontal_rad: 0.5 }),
            image_size_px: None,
            base_to_camera: None,
        };
        assert_eq!(from_message(&MESSAGE), Some(camera.clone()));
        assert_eq!(storage.cameras(1).await.unwrap(), [(0, camera.clone())]);
        assert_eq!(storage.session_camera(1, "first").await.unwrap(), Some(camera));
        let kept = sqlx::query_scalar("SELECT count(*) FROM sessions WHERE camera_message IS NOT NULL");
        assert_eq!(kept.fetch_one(&storage.readers).await.ok(), Some(1_i64));
        storage.close().await;
    }
}
