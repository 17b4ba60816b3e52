//! What the server has to say of itself: what it refused, how it fared, and which servers there are beside it.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InQuery, Nothing, Paging};
use crate::pages::Page;
use crate::service::Service;
use crate::wire::cluster::cluster;
use crate::wire::events::{metrics_history, refusal};

/// What was refused since the server began, newest first: requests of both ports, and frames, wheel reports and goals on
/// open streams. The last 1000 are kept. For administrators of the whole server.
#[utoipa::path(get, path = "/v1/refusals", tag = "server", params(Paging),
    responses((status = 200, description = "A page of refusals.", body = v1::ListRefusalsResponse), Refusals))]
pub(super) async fn list_refusals(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListRefusalsResponse>, HttpError> {
    let Page { items, next } = service.refusals.list(page_size, &page_token)?;
    let refusals = items.into_iter().map(refusal).collect();
    Ok(Json(v1::ListRefusalsResponse { refusals, next_page_token: next }))
}

/// The servers of the database, and how they and it do. Whichever server is asked, the one that owns the database answers.
/// For administrators of the whole server.
#[utoipa::path(get, path = "/v1/cluster", tag = "server",
    responses((status = 200, description = "The servers and their database.", body = v1::Cluster), Refusals))]
pub(super) async fn get_cluster(
    State(service): State<Arc<Service>>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Cluster>, HttpError> {
    Ok(Json(cluster(service.cluster.view().await?)))
}

/// How the server fared over the last hour: its metrics, every 15 seconds. `/metrics` has them as they are now, for
/// Prometheus.
#[utoipa::path(get, path = "/v1/metrics-history", tag = "server",
    responses((status = 200, description = "What the metrics were.", body = v1::MetricsHistory), Refusals))]
pub(super) async fn get_metrics_history(
    State(service): State<Arc<Service>>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Json<v1::MetricsHistory> {
    Json(metrics_history(service.history.view()))
}
