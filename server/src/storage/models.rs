use sqlx::{Any, Transaction};

use super::jobs::{JobEnd, end_job};
use super::values::to_sql;
use super::{Storage, StorageError};

/// What is known of a model without reading its file.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct ModelRow {
    pub(crate) hash: String,
    pub(crate) display_name: String,
    pub(crate) extractor: String,
    #[sqlx(try_from = "i64")]
    pub(crate) words: u64,
    #[sqlx(try_from = "i64")]
    pub(crate) samples: u64,
    pub(crate) words_hash: String,
    #[sqlx(try_from = "i64")]
    pub(crate) size_bytes: u64,
    pub(crate) created_ns: i64,
}

impl Storage {
    /// Stores a model file; of one that is there already, at most the name changes. Whether it was not there yet.
    pub(crate) async fn put_model(&self, row: &ModelRow, file: &[u8]) -> Result<bool, StorageError> {
        self.write(async |transaction| insert_model(transaction, row, file).await).await
    }

    /// Stores the model that a job made, and ends the job: both or neither.
    pub(crate) async fn put_trained_model(
        &self,
        row: &ModelRow,
        file: &[u8],
        end: &JobEnd,
    ) -> Result<(), StorageError> {
        self.write(async |transaction| {
            insert_model(transaction, row, file).await?;
            end_job(transaction, end).await
        })
        .await
    }

    /// Models after `after` (creation time and hash of the last one seen), newest first.
    pub(crate) async fn models(
        &self,
        after: Option<(i64, &str)>,
        limit: u32,
    ) -> Result<Vec<ModelRow>, StorageError> {
        let (created_ns, hash) = after.unwrap_or((i64::MAX, ""));
        Ok(sqlx::query_as(
            "SELECT hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns FROM models \
             WHERE created_ns < $1 OR (created_ns = $1 AND hash > $2) ORDER BY created_ns DESC, hash LIMIT $3",
        )
        .bind(created_ns)
        .bind(hash)
        .bind(i64::from(limit))
        .fetch_all(&self.readers)
        .await?)
    }

    /// Models whose hash begins with `beginning`; at most two, which is enough to see that it is
    /// ambiguous.
    pub(crate) async fn models_by_hash(&self, beginning: &str) -> Result<Vec<ModelRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns FROM models \
             WHERE substr(hash, 1, length($1)) = $1 ORDER BY hash LIMIT 2",
        )
        .bind(beginning)
        .fetch_all(&self.readers)
        .await?)
    }

    /// Models of that display name; at most two.
    pub(crate) async fn models_by_display_name(&self, name: &str) -> Result<Vec<ModelRow>, StorageError> {
        Ok(sqlx::query_as(
            "SELECT hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns FROM models \
             WHERE display_name = $1 ORDER BY hash LIMIT 2",
        )
        .bind(name)
        .fetch_all(&self.readers)
        .await?)
    }

    /// The file of a model. [`StorageError::DamagedModel`] if it is not as it was written.
    pub(crate) async fn model_file(&self, hash: &str) -> Result<Option<Vec<u8>>, StorageError> {
        let read = sqlx::query_scalar("SELECT file FROM models WHERE hash = $1").bind(hash);
        read.fetch_optional(&self.readers).await.map_err(|error| StorageError::of_model(hash, error))
    }

    /// Whether there was one.
    pub(crate) async fn rename_model(&self, hash: &str, display_name: &str) -> Result<bool, StorageError> {
        self.write(async |transaction| {
            let done = sqlx::query("UPDATE models SET display_name = $1 WHERE hash = $2")
                .bind(display_name)
                .bind(hash)
                .execute(&mut **transaction)
                .await?;
            Ok(done.rows_affected() > 0)
        })
        .await
    }

    /// Whether there was one. [`StorageError::InUse`] while a map uses it.
    pub(crate) async fn delete_model(&self, hash: &str) -> Result<bool, StorageError> {
        self.write(async |transaction| {
            let done = sqlx::query("DELETE FROM models WHERE hash = $1")
                .bind(hash)
                .execute(&mut **transaction)
                .await?;
            Ok(done.rows_affected() > 0)
        })
        .await
    }
}

/// Whether it was not there yet. One that is there and has no name takes that of `row`; all else of it stays.
pub(super) async fn insert_model(
    transaction: &mut Transaction<'_, Any>,
    row: &ModelRow,
    file: &[u8],
) -> Result<bool, StorageError> {
    let ModelRow { hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns } = row;
    let done = sqlx::query(
        "INSERT INTO models (hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns, file) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) ON CONFLICT (hash) DO NOTHING",
    )
    .bind(hash)
    .bind(display_name)
    .bind(extractor)
    .bind(to_sql(*words))
    .bind(to_sql(*samples))
    .bind(words_hash)
    .bind(to_sql(*size_bytes))
    .bind(created_ns)
    .bind(file)
    .execute(&mut **transaction)
    .await?;
    if done.rows_affected() > 0 {
        return Ok(true);
    }
    // An import of a map that had brought it leaves it, if it comes to nothing: somebody else has it stored, too.
    sqlx::query("UPDATE jobs SET result = NULL WHERE kind = 'import_map' AND state != 'succeeded' AND result = 'models/' || $1")
        .bind(hash)
        .execute(&mut **transaction)
        .await?;
    sqlx::query("UPDATE models SET display_name = $1 WHERE hash = $2 AND display_name = ''")
        .bind(display_name)
        .bind(hash)
        .execute(&mut **transaction)
        .await?;
    Ok(false)
}
