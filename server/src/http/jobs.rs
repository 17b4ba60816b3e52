use std::sync::Arc;

use axum::extract::State;
use axum::{Extension, Json};
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, JobPath, Nothing, Paging};
use crate::pages::Page;
use crate::service::Service;
use crate::service::tokens::Caller;
use crate::wire::jobs::job as message;

/// All jobs, newest first; those that have ended are kept for 30 days.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs", params(Paging),
    responses((status = 200, description = "A page of jobs.", body = v1::ListJobsResponse), Refusals))]
pub(super) async fn list_jobs(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListJobsResponse>, HttpError> {
    let Page { items, next } = service.jobs.list(&caller, page_size, &page_token).await?;
    let jobs = items.into_iter().map(message).collect();
    Ok(Json(v1::ListJobsResponse { jobs, next_page_token: next }))
}

/// A job.
#[utoipa::path(get, path = "/v1/jobs/{job}", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The job as it stands.", body = v1::Job), Refusals))]
pub(super) async fn get_job(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(JobPath { job }): InPath<JobPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Job>, HttpError> {
    Ok(Json(message(service.jobs.get(&caller, &format!("jobs/{job}")).await?)))
}

/// Asks a job to end before it is done; one that has ended already stays as it is. For administrators.
#[utoipa::path(post, path = "/v1/jobs/{job}/cancel", tag = "jobs", params(JobPath),
    responses((status = 200, description = "The job as it stands; it may take a moment to end.", body = v1::Job), Refusals))]
pub(super) async fn cancel_job(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(JobPath { job }): InPath<JobPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Job>, HttpError> {
    Ok(Json(message(service.jobs.cancel(&caller, &format!("jobs/{job}")).await?)))
}
