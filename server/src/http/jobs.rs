use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::HttpError;
use super::description::Refusals;
use super::models::Model;
use super::parameters::{InPath, InQuery, JobPath, Nothing, Paging};
use crate::service::models::Page;
use crate::service::{Service, jobs};
use crate::storage;

/// All jobs, newest first; those that have ended are kept for 30 days.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs", params(Paging),
    responses((status = 200, description = "A page of jobs.", body = JobList), Refusals))]
pub(super) async fn list_jobs(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<JobList>, HttpError> {
    let Page { items, next } = service.list_jobs(page_size, &page_token).await?;
    Ok(Json(JobList { jobs: items.into_iter().map(Job::from).collect(), next_page_token: next }))
}

/// A job.
#[utoipa::path(get, path = "/v1/jobs/{job}", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The job as it stands.", body = Job), Refusals))]
pub(super) async fn get_job(
    State(service): State<Arc<Service>>,
    InPath(JobPath { job }): InPath<JobPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Job>, HttpError> {
    Ok(Json(service.job(&format!("jobs/{job}")).await?.into()))
}

/// A page of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct JobList {
    jobs: Vec<Job>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// Work that takes longer than a call.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Job {
    /// `jobs/{number}`
    name: String,
    state: JobState,
    /// What it is, or was last, busy with, in words.
    stage: String,
    /// How much of that stage is done.
    #[schema(minimum = 0, maximum = 1)]
    fraction: f64,
    /// Why it failed and how to mend it.
    #[schema(required)]
    error: Option<String>,
    /// The model that a training made.
    #[schema(required)]
    model: Option<Model>,
    kind: JobKind,
    /// What it made, as `models/{hash}`, `maps/{map}` or `merges/{number}`.
    #[schema(required)]
    result: Option<String>,
    create_time_ns: i64,
    /// Null while it runs.
    #[schema(required)]
    end_time_ns: Option<i64>,
}

#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum JobKind {
    TrainModel,
    ImportMap,
    MergeMaps,
    RemoveSessions,
    RebuildMap,
    CompactMap,
}

#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum JobState {
    Running,
    Succeeded,
    Failed,
    Cancelled,
}

impl From<jobs::JobStatus> for Job {
    fn from(status: jobs::JobStatus) -> Self {
        let jobs::JobStatus { number, kind, state, stage, fraction, created_ns, ended_ns } = status;
        let (state, error, made) = match state {
            jobs::JobState::Running => (JobState::Running, None, None),
            jobs::JobState::Succeeded(made) => (JobState::Succeeded, None, Some(made)),
            jobs::JobState::Failed(error) => (JobState::Failed, Some(error), None),
            jobs::JobState::Cancelled => (JobState::Cancelled, None, None),
        };
        let (result, model) = match made {
            Some(jobs::JobResult { name, model }) => (Some(name), model.map(|model| (*model).into())),
            None => (None, None),
        };
        let kind = match kind {
            storage::JobKind::TrainModel => JobKind::TrainModel,
            storage::JobKind::ImportMap => JobKind::ImportMap,
            storage::JobKind::MergeMaps => JobKind::MergeMaps,
            storage::JobKind::RemoveSessions => JobKind::RemoveSessions,
            storage::JobKind::RebuildMap => JobKind::RebuildMap,
            storage::JobKind::CompactMap => JobKind::CompactMap,
        };
        Self {
            name: format!("jobs/{number}"),
            state,
            stage,
            fraction,
            error,
            model,
            kind,
            result,
            create_time_ns: created_ns,
            end_time_ns: ended_ns,
        }
    }
}
