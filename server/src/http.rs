//! REST, for people and scripts: what the maps hold, where robots are to go, and how maps, models and tokens come and go.

mod access;
mod appearance;
mod bodies;
mod corrections;
mod cross_origin;
mod description;
mod events;
mod explanations;
mod exports;
mod frames;
mod inspector;
mod jobs;
mod maps;
mod match_matrix;
mod merges;
mod models;
mod navigations;
mod pages;
mod parameters;
mod pictures;
mod places;
mod queries;
mod requests;
mod sent_frames;
mod server;
mod sessions;
mod snapshots;
mod tokens;
mod trajectories;
mod uploads;

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{DefaultBodyLimit, State};
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Extension, Json, Router};
use axum_server::Handle;
use hyper_util::rt::{TokioExecutor, TokioTimer};
use hyper_util::server::conn::auto;
use serde::Serialize;
use tokio::net::TcpListener;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate};
use utoipa::ToSchema;
use utoipa_axum::router::{OpenApiRouter, UtoipaMethodRouterExt};
use utoipa_axum::routes;

use crate::error::ServiceError;
use crate::net::connections::{Came, Connections, Limits, Port};
use crate::net::origin::Origin;
use crate::net::standing::Strangers;
use crate::net::tls::Tls;
use crate::service::Service;

/// Largest body of a request.
const MAX_BODY_BYTES: usize = 5 << 20;

/// All headers of a request together.
const MAX_HEADER_BYTES: u32 = 16 << 10;

/// Within which the headers of a request must come; also how long an idle connection is kept.
const HEADER_TIMEOUT: Duration = Duration::from_secs(15);

/// Browsers take six connections each.
pub(crate) const LIMITS: Limits =
    Limits { connections: 256, kept_for_strangers: 16, patience: Duration::from_secs(10) };

/// Requests that one connection may have open at a time, with HTTP/2.
const MAX_STREAMS_PER_CONNECTION: u32 = 64;

/// A browser that is gone without a word is noticed after two of these, with HTTP/2.
const KEEPALIVE: Duration = Duration::from_secs(20);

pub(crate) async fn serve(
    service: Arc<Service>,
    listener: TcpListener,
    tls: Option<&Tls>,
    strangers: Strangers,
    cors_origins: Vec<Origin>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> anyhow::Result<()> {
    let routes = router(service, cors_origins)?;
    let routes = match tls {
        Some(_) => routes.layer(map_response(pages::encrypted_alone)),
        None => routes,
    };
    let routes = routes.into_make_service_with_connect_info::<Came>();
    let connections = Connections::at(listener, tls.map(|tls| tls.http.clone()), LIMITS, strangers)?;
    let handle: Handle<Port> = Handle::new();
    let stopping = handle.clone();
    tokio::spawn(async move {
        shutdown.await;
        stopping.graceful_shutdown(None);
    });
    let mut server = axum_server::Server::from_listener(connections).handle(handle);
    limit(server.http_builder());
    server.serve(routes).await?;
    Ok(())
}

/// What a connection of HTTP may take.
pub(crate) fn limit(connections: &mut auto::Builder<TokioExecutor>) {
    let timer = TokioTimer::new;
    connections
        .http1()
        .timer(timer())
        .header_read_timeout(HEADER_TIMEOUT)
        .max_buf_size(MAX_HEADER_BYTES as usize);
    connections
        .http2()
        .timer(timer())
        .keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .max_concurrent_streams(MAX_STREAMS_PER_CONNECTION)
        .max_header_list_size(MAX_HEADER_BYTES);
}

/// Text, for those who ask for it compressed. Snapshots and models are of numbers and as long as they are large.
fn worth_compressing() -> impl Predicate {
    DefaultPredicate::new().and(NotForContentType::const_new("application/octet-stream"))
}

/// All routes, guarded, for pages of these origins too.
pub(crate) fn router(service: Arc<Service>, cors_origins: Vec<Origin>) -> anyhow::Result<Router> {
    let cross_origin = cross_origin::layer(&cors_origins);
    let asked = access::Asked { service: service.clone(), origins: cors_origins.into() };
    let (api, description) = api().split_for_parts();
    let routes = api
        .merge(description::routes(&description)?)
        .merge(inspector::routes())
        .route("/healthz", get(alive))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics))
        .fallback(nowhere)
        .method_not_allowed_fallback(wrong_method)
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
        .layer(from_fn_with_state(asked, access::guard))
        .layer(from_fn_with_state(service.clone(), requests::watch))
        .with_state(service)
        .layer(CompressionLayer::new().compress_when(worth_compressing()))
        .layer(map_response(pages::harmless));
    // Outside of the guard: a browser asks whether it may ask before it sends a token.
    Ok(match cross_origin {
        Some(layer) => routes.layer(layer),
        None => routes,
    })
}

/// The routes and their description at once, so that neither knows what the other does not.
fn api() -> OpenApiRouter<Arc<Service>> {
    description::begin()
        .routes(routes!(maps::list_maps, maps::create_map))
        .routes(routes!(maps::get_map, maps::delete_map))
        .routes(routes!(snapshots::export_map))
        .routes(routes!(snapshots::import_map))
        .routes(routes!(events::watch_map))
        .routes(routes!(places::list_places))
        .routes(routes!(places::get_place))
        .routes(routes!(places::list_word_places))
        .routes(routes!(match_matrix::get_match_matrix))
        .routes(routes!(match_matrix::get_match_matrix_tile))
        .routes(routes!(maps::list_loop_closures))
        .routes(routes!(corrections::list_corrections, corrections::correct_map))
        .routes(routes!(corrections::undo_correction))
        .routes(routes!(queries::query).layer(DefaultBodyLimit::max(queries::MAX_BODY_BYTES)))
        .routes(routes!(sessions::list_sessions))
        .routes(routes!(sessions::list_open_streams))
        .routes(routes!(sessions::get_session, sessions::delete_session))
        .routes(routes!(sessions::list_frames))
        .routes(
            routes!(frames::get_frame, sent_frames::put_frame)
                .layer(DefaultBodyLimit::max(queries::MAX_BODY_BYTES)),
        )
        .routes(routes!(frames::get_frame_image))
        .routes(routes!(explanations::explain_frame))
        .routes(routes!(pictures::get_frame_picture))
        .routes(routes!(exports::export_loop_closures_csv))
        .routes(routes!(exports::export_loop_closures_json))
        .routes(routes!(exports::export_posteriors_csv))
        .routes(routes!(exports::export_posteriors_json))
        .routes(routes!(trajectories::export_trajectory))
        .routes(routes!(trajectories::export_graph))
        .routes(routes!(navigations::list_navigations))
        .routes(routes!(navigations::get_navigation))
        .routes(routes!(navigations::set_goal, navigations::cancel_goal))
        .routes(routes!(navigations::plan_route))
        .routes(routes!(merges::list_merges, merges::merge_maps))
        .routes(routes!(merges::get_merge))
        .routes(routes!(merges::get_merge_picture))
        .routes(routes!(merges::decide_merge))
        .routes(routes!(appearance::list_labels))
        .routes(routes!(appearance::set_label, appearance::delete_label))
        .routes(routes!(appearance::get_appearance_graph))
        .routes(routes!(models::list_models, models::import_model))
        .routes(routes!(models::get_model, models::delete_model))
        .routes(routes!(models::rename_model))
        .routes(routes!(models::export_model))
        .routes(routes!(server::list_refusals))
        .routes(routes!(server::get_metrics_history))
        .routes(routes!(server::get_cluster))
        .routes(routes!(jobs::list_jobs))
        .routes(routes!(jobs::get_job))
        .routes(routes!(jobs::cancel_job))
        .routes(routes!(tokens::list_tokens, tokens::create_token))
        .routes(routes!(tokens::update_token, tokens::delete_token))
        .routes(routes!(tokens::rotate_token))
        .routes(routes!(tokens::get_caller))
}

/// That it answers at all is the answer.
async fn alive() -> &'static str {
    "ok\n"
}

async fn ready(State(service): State<Arc<Service>>) -> Result<&'static str, HttpError> {
    service.ready().await?;
    Ok("ready\n")
}

async fn metrics(State(service): State<Arc<Service>>) -> impl IntoResponse {
    let kind = [(http::header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")];
    (kind, service.rendered_metrics().await)
}

async fn nowhere() -> HttpError {
    nothing_here()
}

fn nothing_here() -> HttpError {
    HttpError(ServiceError::not_found(
        "there is nothing here; /v1/maps lists the maps, and /docs says what else there is",
    ))
}

/// The router itself adds which methods are allowed.
async fn wrong_method() -> Response {
    let message = "this route does not take that method: the header Allow says which it takes, and /docs what \
                   each does; frames go by PUT, and a robot's stream over gRPC";
    error_response(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", message.to_owned())
}

/// An error as status and JSON: a problem as RFC 9457 has it, with `"error": {"code": "not_found", "message": "…"}` beside.
#[derive(Debug)]
pub(crate) struct HttpError(ServiceError);

impl From<ServiceError> for HttpError {
    fn from(error: ServiceError) -> Self {
        Self(error)
    }
}

/// What kind of JSON an error is.
const PROBLEM: HeaderValue = HeaderValue::from_static("application/problem+json");

/// What is said when a request is not served.
#[derive(Serialize, ToSchema)]
#[schema(example = json!({
    "type": "about:blank",
    "title": "Not Found",
    "status": 404,
    "detail": "there is no map attic; list the maps to see what there is, or create it",
    "error": {
        "code": "not_found",
        "message": "there is no map attic; list the maps to see what there is, or create it"
    }
}))]
struct ErrorBody {
    /// Always `about:blank`: the title says what the status does.
    r#type: &'static str,
    /// What the status says, for people.
    title: &'static str,
    /// The status of the answer.
    status: u16,
    /// As `error.message`.
    detail: String,
    error: ErrorContent,
}

#[derive(Serialize, ToSchema)]
struct ErrorContent {
    /// The kind of error, for programs: gRPC's status in lower snake case where there is one.
    code: &'static str,
    /// What is wrong and how to mend it, for people.
    message: String,
}

fn error_body(status: StatusCode, code: &'static str, message: String) -> ErrorBody {
    ErrorBody {
        r#type: "about:blank",
        title: status.canonical_reason().unwrap_or("Unknown"),
        status: status.as_u16(),
        detail: message.clone(),
        error: ErrorContent { code, message },
    }
}

/// Why a request was refused, beside its answer, for whoever watches over it.
#[derive(Clone, Debug)]
struct Said {
    code: &'static str,
    message: String,
}

fn error_response(status: StatusCode, code: &'static str, message: String) -> Response {
    let said = Said { code, message: message.clone() };
    let body = Json(error_body(status, code, message));
    (status, [(CONTENT_TYPE, PROBLEM)], Extension(said), body).into_response()
}

impl HttpError {
    fn status(&self) -> StatusCode {
        match &self.0 {
            ServiceError::InvalidArgument { .. } => StatusCode::BAD_REQUEST,
            ServiceError::NotFound { .. } => StatusCode::NOT_FOUND,
            ServiceError::AlreadyExists { .. }
            | ServiceError::FailedPrecondition { .. }
            | ServiceError::Aborted { .. } => StatusCode::CONFLICT,
            ServiceError::ResourceExhausted { .. } | ServiceError::QuotaUsedUp { .. } => {
                StatusCode::TOO_MANY_REQUESTS
            }
            ServiceError::Unavailable { .. } => StatusCode::SERVICE_UNAVAILABLE,
            ServiceError::Unauthenticated { .. } => StatusCode::UNAUTHORIZED,
            ServiceError::PermissionDenied { .. } => StatusCode::FORBIDDEN,
            ServiceError::DeadlineExceeded { .. } => StatusCode::GATEWAY_TIMEOUT,
            ServiceError::DataLoss { .. } | ServiceError::Internal => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }

    /// What the body of a refusal is, for an answer that has begun already.
    fn body(&self) -> ErrorBody {
        error_body(self.status(), self.0.code_name(), self.0.to_string())
    }
}

impl IntoResponse for HttpError {
    fn into_response(self) -> Response {
        let mut response = error_response(self.status(), self.0.code_name(), self.0.to_string());
        if let Some(retry_after) = self.0.retry_after() {
            let seconds = HeaderValue::from(retry_after.as_secs_f64().ceil() as u64);
            response.headers_mut().insert(RETRY_AFTER, seconds);
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Metrics;
    use crate::service::tokens::Tokens;
    use crate::storage::Storage;

    #[tokio::test]
    async fn a_server_that_stops_is_not_ready_but_alive() {
        let directory = tempfile::tempdir().unwrap();
        let storage = Storage::open(directory.path()).await.unwrap();
        let tokens = Tokens::load(&storage).await.unwrap();
        let service = Arc::new(Service::new(storage.clone(), tokens, Metrics::new().unwrap()));
        let answered = async || ready(State(service.clone())).await.into_response();
        assert_eq!(answered().await.status(), StatusCode::OK);
        storage.close().await;
        let silent = answered().await;
        assert_eq!(silent.status(), StatusCode::SERVICE_UNAVAILABLE, "the database is closed");
        service.stopping().cancel();
        let stopping = answered().await;
        assert_eq!(stopping.status(), StatusCode::SERVICE_UNAVAILABLE);
        let body = axum::body::to_bytes(stopping.into_body(), MAX_BODY_BYTES).await.unwrap();
        assert!(String::from_utf8_lossy(&body).contains("the server is stopping"));
        assert_eq!(alive().await, "ok\n");
    }
}
