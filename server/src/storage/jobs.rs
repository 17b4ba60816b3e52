use sqlx::sqlite::SqliteRow;
use sqlx::{Row, Sqlite, Transaction};

use super::{Storage, StorageError, from_sql, to_sql};

/// A job as the table has it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JobRow {
    pub(crate) number: u64,
    pub(crate) kind: JobKind,
    pub(crate) state: StoredJobState,
    /// What it is, or was last, busy with.
    pub(crate) stage: String,
    /// What it made; while it runs, the model that it brought in on the way.
    pub(crate) result: Option<String>,
    /// Why it failed, for the user.
    pub(crate) error: Option<String>,
    pub(crate) created_ns: i64,
    pub(crate) ended_ns: Option<i64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum JobKind {
    TrainModel,
    ImportMap,
    MergeMaps,
    RemoveSessions,
    RebuildMap,
    CompactMap,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StoredJobState {
    Running,
    Succeeded,
    Failed,
    Cancelled,
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JobEnd {
    pub(crate) number: u64,
    pub(crate) state: StoredJobState,
    pub(crate) stage: String,
    pub(crate) result: Option<String>,
    pub(crate) error: Option<String>,
    pub(crate) ended_ns: i64,
}

const COLUMNS: &str = "number, kind, state, stage, result, error, created_ns, ended_ns";

impl Storage {
    /// Adds a job that runs; gives its number.
    pub(crate) async fn insert_job(
        &self,
        kind: JobKind,
        stage: &str,
        created_ns: i64,
    ) -> Result<u64, StorageError> {
        self.write(async |transaction| {
            let done =
                sqlx::query("INSERT INTO jobs (kind, state, stage, created_ns) VALUES (?, 'running', ?, ?)")
                    .bind(kind.name())
                    .bind(stage)
                    .bind(created_ns)
                    .execute(&mut **transaction)
                    .await?;
            from_sql(done.last_insert_rowid())
        })
        .await
    }

    pub(crate) async fn end_job(&self, end: &JobEnd) -> Result<(), StorageError> {
        self.write(async |transaction| end_job(transaction, end).await).await
    }

    pub(crate) async fn job(&self, number: u64) -> Result<Option<JobRow>, StorageError> {
        let query = format!("SELECT {COLUMNS} FROM jobs WHERE number = ?");
        let row = sqlx::query(sqlx::AssertSqlSafe(query))
            .bind(to_sql(number))
            .fetch_optional(&self.readers)
            .await?;
        row.as_ref().map(job).transpose()
    }

    /// Jobs with a number below `before` (all if `None`), newest first.
    pub(crate) async fn jobs(&self, before: Option<u64>, limit: u32) -> Result<Vec<JobRow>, StorageError> {
        let query = format!("SELECT {COLUMNS} FROM jobs WHERE number < ? ORDER BY number DESC LIMIT ?");
        let rows = sqlx::query(sqlx::AssertSqlSafe(query))
            .bind(before.map_or(i64::MAX, to_sql))
            .bind(limit)
            .fetch_all(&self.readers)
            .await?;
        rows.iter().map(job).collect()
    }

    /// Every job that still runs has failed. What such a job brought in on the way stays noted in its
    /// row; see [`Storage::drop_unfinished_model`].
    pub(crate) async fn fail_running_jobs(&self, error: &str, ended_ns: i64) -> Result<u64, StorageError> {
        self.write(async |transaction| {
            let done = sqlx::query(
                "UPDATE jobs SET state = 'failed', error = ?, ended_ns = ? WHERE state = 'running'",
            )
            .bind(error)
            .bind(ended_ns)
            .execute(&mut **transaction)
            .await?;
            Ok(done.rows_affected())
        })
        .await
    }

    /// Forgets jobs that ended before `ended_ns`, but for those with something left to clean up.
    pub(crate) async fn delete_jobs_ended_before(&self, ended_ns: i64) -> Result<u64, StorageError> {
        self.write(async |transaction| {
            let done = sqlx::query(
                "DELETE FROM jobs WHERE ended_ns < ? AND (state = 'succeeded' OR result IS NULL)",
            )
            .bind(ended_ns)
            .execute(&mut **transaction)
            .await?;
            Ok(done.rows_affected())
        })
        .await
    }
}

/// [`StorageError::JobEnded`] unless it runs: one that was cut off must not come to have made something.
pub(super) async fn end_job(
    transaction: &mut Transaction<'_, Sqlite>,
    end: &JobEnd,
) -> Result<(), StorageError> {
    let JobEnd { number, state, stage, result, error, ended_ns } = end;
    // What a job that did not succeed brought in is noted until it is cleaned up.
    let done = sqlx::query(
        "UPDATE jobs SET state = ?1, stage = ?2, result = CASE ?1 WHEN 'succeeded' THEN ?3 ELSE result END, \
         error = ?4, ended_ns = ?5 WHERE number = ?6 AND state = 'running'",
    )
    .bind(state.name())
    .bind(stage)
    .bind(result)
    .bind(error)
    .bind(ended_ns)
    .bind(to_sql(*number))
    .execute(&mut **transaction)
    .await?;
    if done.rows_affected() == 1 { Ok(()) } else { Err(StorageError::JobEnded) }
}

impl JobKind {
    const ALL: [Self; 6] = [
        Self::TrainModel,
        Self::ImportMap,
        Self::MergeMaps,
        Self::RemoveSessions,
        Self::RebuildMap,
        Self::CompactMap,
    ];

    fn name(self) -> &'static str {
        match self {
            JobKind::TrainModel => "train_model",
            JobKind::ImportMap => "import_map",
            JobKind::MergeMaps => "merge_maps",
            JobKind::RemoveSessions => "remove_sessions",
            JobKind::RebuildMap => "rebuild_map",
            JobKind::CompactMap => "compact_map",
        }
    }
}

impl StoredJobState {
    fn name(self) -> &'static str {
        match self {
            StoredJobState::Running => "running",
            StoredJobState::Succeeded => "succeeded",
            StoredJobState::Failed => "failed",
            StoredJobState::Cancelled => "cancelled",
        }
    }
}

fn job(row: &SqliteRow) -> Result<JobRow, StorageError> {
    let damaged = |what: &str| StorageError::Damaged(format!("a job of {what}"));
    let (kind, state): (&str, &str) = (row.try_get("kind")?, row.try_get("state")?);
    Ok(JobRow {
        number: from_sql(row.try_get("number")?)?,
        kind: JobKind::ALL.into_iter().find(|known| known.name() == kind).ok_or_else(|| damaged(kind))?,
        state: [
            StoredJobState::Running,
            StoredJobState::Succeeded,
            StoredJobState::Failed,
            StoredJobState::Cancelled,
        ]
        .into_iter()
        .find(|known| known.name() == state)
        .ok_or_else(|| damaged(state))?,
        stage: row.try_get("stage")?,
        result: row.try_get("result")?,
        error: row.try_get("error")?,
        created_ns: row.try_get("created_ns")?,
        ended_ns: row.try_get("ended_ns")?,
    })
}
