use sqlx::{Any, Transaction};

use super::values::{from_sql, to_sql, words};
use super::{Storage, StorageError};

/// A job as the table has it.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct JobRow {
    #[sqlx(try_from = "i64")]
    pub(crate) number: u64,
    pub(crate) kind: JobKind,
    pub(crate) state: StoredJobState,
    /// What it is, or was last, busy with.
    pub(crate) stage: String,
    /// What it made; while it runs, the model that it brought in on the way.
    pub(crate) result: Option<String>,
    /// Why it failed, for the user.
    #[sqlx(flatten, try_from = "ErrorColumns")]
    pub(crate) error: Option<StoredError>,
    pub(crate) created_ns: i64,
    pub(crate) ended_ns: Option<i64>,
    /// The maps that it reads or writes, with commas between them; `None` if that is not known.
    pub(crate) maps: Option<String>,
    /// What it was asked for, if another server can go on with it.
    pub(crate) task: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum JobKind {
    TrainModel,
    ImportMap,
    MergeMaps,
    RemoveSessions,
    RebuildMap,
    RepairMap,
    CompactMap,
}

words!(JobKind {
    TrainModel = "train_model",
    ImportMap = "import_map",
    MergeMaps = "merge_maps",
    RemoveSessions = "remove_sessions",
    RebuildMap = "rebuild_map",
    RepairMap = "repair_map",
    CompactMap = "compact_map",
});

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StoredJobState {
    Running,
    Succeeded,
    Failed,
    Cancelled,
}

words!(StoredJobState {
    Running = "running",
    Succeeded = "succeeded",
    Failed = "failed",
    Cancelled = "cancelled",
});

/// A job that is to be noted.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NewJob {
    pub(crate) kind: JobKind,
    /// As in [`JobRow`].
    pub(crate) maps: String,
    pub(crate) task: Option<String>,
    pub(crate) stage: &'static str,
    pub(crate) created_ns: i64,
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JobEnd {
    pub(crate) number: u64,
    pub(crate) state: StoredJobState,
    pub(crate) stage: String,
    pub(crate) result: Option<String>,
    pub(crate) error: Option<StoredError>,
    pub(crate) ended_ns: i64,
}

/// Why a job or a merge failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StoredError {
    /// Kind of the error in one word, as in `not_found`.
    pub(crate) code: String,
    pub(crate) message: String,
}

/// A job or a merge without a message has not failed, whatever its code.
#[derive(sqlx::FromRow)]
pub(super) struct ErrorColumns {
    error: Option<String>,
    error_code: String,
}

impl From<ErrorColumns> for Option<StoredError> {
    fn from(ErrorColumns { error, error_code: code }: ErrorColumns) -> Self {
        error.map(|message| StoredError { code, message })
    }
}

const COLUMNS: &str =
    "number, kind, state, stage, result, error, error_code, created_ns, ended_ns, maps, task";

impl Storage {
    /// Adds a job that runs; gives its number.
    pub(crate) async fn insert_job(&self, job: &NewJob) -> Result<u64, StorageError> {
        let NewJob { kind, maps, task, stage, created_ns } = job;
        self.write(async |transaction| {
            let number = sqlx::query_scalar(
                "INSERT INTO jobs (kind, maps, task, state, stage, created_ns) \
                 VALUES ($1, $2, $3, 'running', $4, $5) RETURNING number",
            )
            .bind(kind)
            .bind(maps)
            .bind(task)
            .bind(*stage)
            .bind(created_ns)
            .fetch_one(&mut **transaction)
            .await?;
            from_sql(number)
        })
        .await
    }

    /// Whether a job of that kind was ever begun about maps, the first of which are these; jobs are kept for 30 days.
    pub(crate) async fn was_begun(&self, kind: JobKind, maps: &[&str]) -> Result<bool, StorageError> {
        let found = sqlx::query(
            "SELECT 1 FROM jobs WHERE kind = $1 AND substr(maps || ',', 1, length($2)) = $2 LIMIT 1",
        )
        .bind(kind)
        .bind(format!("{},", maps.join(",")))
        .fetch_optional(&self.readers)
        .await?;
        Ok(found.is_some())
    }

    pub(crate) async fn end_job(&self, end: &JobEnd) -> Result<(), StorageError> {
        self.write(async |transaction| end_job(transaction, end).await).await
    }

    pub(crate) async fn job(&self, number: u64) -> Result<Option<JobRow>, StorageError> {
        let query = format!("SELECT {COLUMNS} FROM jobs WHERE number = $1");
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(query))
            .bind(to_sql(number))
            .fetch_optional(&self.readers)
            .await?)
    }

    /// Jobs with a number below `before` (all if `None`), newest first.
    pub(crate) async fn jobs(&self, before: Option<u64>, limit: u32) -> Result<Vec<JobRow>, StorageError> {
        let query = format!("SELECT {COLUMNS} FROM jobs WHERE number < $1 ORDER BY number DESC LIMIT $2");
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(query))
            .bind(before.map_or(i64::MAX, to_sql))
            .bind(i64::from(limit))
            .fetch_all(&self.readers)
            .await?)
    }

    /// Every job that still runs, and with which no server can go on, has failed. What such a job brought in on the way stays
    /// noted in its row; see [`Storage::drop_unfinished_model`].
    pub(crate) async fn fail_jobs_without_task(
        &self,
        error: &StoredError,
        ended_ns: i64,
    ) -> Result<u64, StorageError> {
        let which = "task IS NULL";
        self.fail_running_jobs(which, error, ended_ns).await
    }

    /// Every job that still runs, and on which so many servers have ended, has failed.
    pub(crate) async fn fail_jobs_begun(
        &self,
        times: u32,
        error: &StoredError,
        ended_ns: i64,
    ) -> Result<u64, StorageError> {
        self.fail_running_jobs(&format!("begun >= {times}"), error, ended_ns).await
    }

    async fn fail_running_jobs(
        &self,
        which: &str,
        error: &StoredError,
        ended_ns: i64,
    ) -> Result<u64, StorageError> {
        let query = format!(
            "UPDATE jobs SET state = 'failed', error = $1, error_code = $2, ended_ns = $3 \
             WHERE state = 'running' AND {which}"
        );
        self.write(async |transaction| {
            let done = sqlx::query(sqlx::AssertSqlSafe(query))
                .bind(&error.message)
                .bind(&error.code)
                .bind(ended_ns)
                .execute(&mut **transaction)
                .await?;
            Ok(done.rows_affected())
        })
        .await
    }

    /// The numbers of the jobs that still run, oldest first.
    pub(crate) async fn running_jobs(&self) -> Result<Vec<u64>, StorageError> {
        let numbers: Vec<i64> =
            sqlx::query_scalar("SELECT number FROM jobs WHERE state = 'running' ORDER BY number")
                .fetch_all(&self.readers)
                .await?;
        numbers.into_iter().map(from_sql).collect()
    }

    /// A server works on the job from now on; it is taken back if that server stops in good order.
    pub(crate) async fn count_beginning(&self, number: u64) -> Result<(), StorageError> {
        self.change_job(number, "begun = begun + 1").await
    }

    pub(crate) async fn take_back_beginning(&self, number: u64) -> Result<(), StorageError> {
        self.change_job(number, "begun = begun - 1").await
    }

    /// No other server goes on with the job.
    pub(crate) async fn forget_task(&self, number: u64) -> Result<(), StorageError> {
        self.change_job(number, "task = NULL").await
    }

    async fn change_job(&self, number: u64, change: &str) -> Result<(), StorageError> {
        let query = format!("UPDATE jobs SET {change} WHERE number = $1");
        self.write(async |transaction| {
            sqlx::query(sqlx::AssertSqlSafe(query)).bind(to_sql(number)).execute(&mut **transaction).await?;
            Ok(())
        })
        .await
    }

    /// Forgets jobs that ended before `ended_ns`, but for those with something left to clean up.
    pub(crate) async fn delete_jobs_ended_before(&self, ended_ns: i64) -> Result<u64, StorageError> {
        self.write(async |transaction| {
            let done = sqlx::query(
                "DELETE FROM jobs WHERE ended_ns < $1 AND (state = 'succeeded' OR result IS NULL)",
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
    transaction: &mut Transaction<'_, Any>,
    end: &JobEnd,
) -> Result<(), StorageError> {
    let JobEnd { number, state, stage, result, error, ended_ns } = end;
    // What a job that did not succeed brought in is noted until it is cleaned up.
    let done = sqlx::query(
        "UPDATE jobs SET state = $1, stage = $2, result = CASE $1 WHEN 'succeeded' THEN $3 ELSE result END, \
         error = $4, error_code = coalesce($5, error_code), ended_ns = $6 WHERE number = $7 AND state = 'running'",
    )
    .bind(state)
    .bind(stage)
    .bind(result)
    .bind(error.as_ref().map(|error| &error.message))
    .bind(error.as_ref().map(|error| &error.code))
    .bind(ended_ns)
    .bind(to_sql(*number))
    .execute(&mut **transaction)
    .await?;
    if done.rows_affected() == 1 { Ok(()) } else { Err(StorageError::JobEnded) }
}
