//! Maps are taken away piece by piece: a large one in one transaction would hold up every other map's
//! commits.

use super::checkpoints::CHECKPOINT_PIECES;
use super::{MapId, Storage, StorageError, delete_some};

/// What belongs to a map beside its checkpoint, by table: the key within the map, and how many rows are deleted at a time.
/// Images are large.
const TABLES: [(&str, &str, u32); 9] = [
    ("frame_media", "position", 32),
    ("frame_notes", "position", 500),
    ("log", "position", 500),
    ("checkpoints", "events", 1),
    ("map_models", "until_events", 500),
    ("labels", "place", 500),
    ("appearance_links", "place", 500),
    ("appearance_graphs", "next_place", 1),
    ("sessions", "number", 500),
];

/// How far the deletion of a map is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Removal {
    /// Some is left.
    Under,
    Done,
}

impl Storage {
    /// Takes a map out of sight: its name is free, and its rows may be deleted. Whether there was one.
    pub(crate) async fn retire_map(&self, name: &str) -> Result<bool, StorageError> {
        self.write_counted(async |transaction| {
            // Nobody can choose a name with a tilde.
            let done = sqlx::query(
                "UPDATE maps SET name = '~' || id, state = 'deleting' WHERE name = $1 AND state = 'live'",
            )
            .bind(name)
            .execute(&mut **transaction)
            .await?;
            Ok(done.rows_affected() > 0)
        })
        .await
    }

    /// Gives up a map that was being imported.
    pub(crate) async fn retire_import(&self, map: MapId) -> Result<(), StorageError> {
        self.write_counted(async |transaction| {
            sqlx::query(
                "UPDATE maps SET name = '~' || id, state = 'deleting' WHERE id = $1 AND state = 'importing'",
            )
            .bind(map)
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// Gives up all maps that were being imported: for the start of a server, when none is.
    pub(crate) async fn retire_imports(&self) -> Result<(), StorageError> {
        self.write_counted(async |transaction| {
            sqlx::query("UPDATE maps SET name = '~' || id, state = 'deleting' WHERE state = 'importing'")
                .execute(&mut **transaction)
                .await?;
            Ok(())
        })
        .await
    }

    /// The maps whose rows are to be deleted.
    pub(crate) async fn retired_maps(&self) -> Result<Vec<MapId>, StorageError> {
        Ok(sqlx::query_scalar("SELECT id FROM maps WHERE state = 'deleting' ORDER BY id")
            .fetch_all(&self.readers)
            .await?)
    }

    /// Deletes a piece of a retired map, and at last the map itself.
    pub(crate) async fn delete_piece(&self, map: MapId) -> Result<Removal, StorageError> {
        self.write(async |transaction| {
            for table in CHECKPOINT_PIECES.into_iter().chain(TABLES) {
                if delete_some(transaction, map, table).await? > 0 {
                    return Ok(Removal::Under);
                }
            }
            sqlx::query("DELETE FROM maps WHERE id = $1 AND state = 'deleting'")
                .bind(map)
                .execute(&mut **transaction)
                .await?;
            Ok(Removal::Done)
        })
        .await
    }

    /// Whether a map that is being deleted still refers to the model, and no other map does.
    pub(crate) async fn only_retired_maps_use(&self, model: &str) -> Result<bool, StorageError> {
        let others: i64 =
            sqlx::query_scalar("SELECT count(*) FROM maps WHERE model = $1 AND state != 'deleting'")
                .bind(model)
                .fetch_one(&self.readers)
                .await?;
        Ok(others == 0)
    }

    /// Deletes a model that an import brought in and did not come to use, if nothing else uses it.
    /// Whether there was one to look at.
    pub(crate) async fn drop_unfinished_model(&self) -> Result<bool, StorageError> {
        self.write(async |transaction| {
            let unfinished: Option<(i64, String)> = sqlx::query_as(
                "SELECT number, result FROM jobs \
                 WHERE kind = 'import_map' AND state IN ('failed', 'cancelled') AND result IS NOT NULL LIMIT 1",
            )
            .fetch_optional(&mut **transaction)
            .await?;
            let Some((number, result)) = unfinished else { return Ok(false) };
            sqlx::query(
                "DELETE FROM models WHERE 'models/' || hash = $1 \
                 AND NOT EXISTS (SELECT 1 FROM maps WHERE maps.model = models.hash)",
            )
            .bind(result)
            .execute(&mut **transaction)
            .await?;
            sqlx::query("UPDATE jobs SET result = NULL WHERE number = $1")
                .bind(number)
                .execute(&mut **transaction)
                .await?;
            Ok(true)
        })
        .await
    }
}
