//! What was refused lately.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InQuery, Paging};
use crate::pages::Page;
use crate::service::Service;
use crate::wire::events::refusal;

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
