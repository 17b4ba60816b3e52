//! REST, for people: what the maps hold. Reads only.

mod maps;

use std::future::Future;
use std::sync::Arc;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::Serialize;
use tokio::net::TcpListener;

use crate::error::ServiceError;
use crate::service::Service;

pub(crate) async fn serve(
    service: Arc<Service>,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> anyhow::Result<()> {
    axum::serve(listener, router(service)).with_graceful_shutdown(shutdown).await?;
    Ok(())
}

fn router(service: Arc<Service>) -> Router {
    Router::new()
        .route("/healthz", get(health))
        .route("/v1/maps", get(maps::list))
        .route("/v1/maps/{map}", get(maps::map))
        .route("/v1/maps/{map}/places", get(maps::places))
        .route("/v1/maps/{map}/matches", get(maps::matches))
        .fallback(nowhere)
        .with_state(service)
}

async fn health(State(service): State<Arc<Service>>) -> Result<&'static str, HttpError> {
    service.check().await?;
    Ok("ok\n")
}

async fn nowhere() -> HttpError {
    HttpError(ServiceError::not_found(
        "there is nothing here; try /v1/maps, /v1/maps/{map}, /v1/maps/{map}/places or /v1/maps/{map}/matches",
    ))
}

/// An error as status and JSON: `{"error": {"code": "not_found", "message": "…"}}`.
#[derive(Debug)]
pub(crate) struct HttpError(ServiceError);

impl From<ServiceError> for HttpError {
    fn from(error: ServiceError) -> Self {
        Self(error)
    }
}

#[derive(Serialize)]
struct ErrorBody {
    error: ErrorContent,
}

#[derive(Serialize)]
struct ErrorContent {
    code: &'static str,
    message: String,
}

impl IntoResponse for HttpError {
    fn into_response(self) -> Response {
        let (status, code) = match &self.0 {
            ServiceError::InvalidArgument { .. } => (StatusCode::BAD_REQUEST, "invalid_argument"),
            ServiceError::NotFound { .. } => (StatusCode::NOT_FOUND, "not_found"),
            ServiceError::AlreadyExists { .. } => (StatusCode::CONFLICT, "already_exists"),
            ServiceError::FailedPrecondition { .. } => (StatusCode::CONFLICT, "failed_precondition"),
            ServiceError::Aborted { .. } => (StatusCode::CONFLICT, "aborted"),
            ServiceError::ResourceExhausted { .. } => (StatusCode::TOO_MANY_REQUESTS, "resource_exhausted"),
            ServiceError::Unavailable { .. } => (StatusCode::SERVICE_UNAVAILABLE, "unavailable"),
            ServiceError::Internal => (StatusCode::INTERNAL_SERVER_ERROR, "internal"),
        };
        let error = ErrorContent { code, message: self.0.to_string() };
        (status, Json(ErrorBody { error })).into_response()
    }
}
