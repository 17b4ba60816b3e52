//! What places are called, and how they hang together by appearance.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use utoipa::ToSchema;
use waypost_proto::v1;

use super::HttpError;
use super::bodies::{InBody, JsonBody};
use super::description::{BodyRefusals, Refusals};
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, PlacePath};
use crate::names::map_name;
use crate::pages::Page;
use crate::service::Service;
use crate::service::labels;
use crate::wire::places::{graph, labels};

/// The places of a map that have a label, by number.
#[utoipa::path(get, path = "/v1/maps/{map}/labels", tag = "maps", params(MapPath, Paging),
    responses((status = 200, description = "A page of labels.", body = v1::ListLabelsResponse), Refusals))]
pub(super) async fn list_labels(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListLabelsResponse>, HttpError> {
    let Page { items, next } = service.labels.list(&map_name(&map), page_size, &page_token).await?;
    Ok(Json(v1::ListLabelsResponse { labels: labels(&map, items), next_page_token: next }))
}

/// Puts a label on a place, in place of what it had; or on all places of its space.
#[utoipa::path(put, path = "/v1/maps/{map}/places/{place}/label", tag = "maps", params(PlacePath),
    request_body(content = Labelling, description = "The label, and on which places it is put."),
    responses((status = 200, description = "The places that were labelled.", body = v1::SetLabelResponse), Refusals, BodyRefusals))]
pub(super) async fn set_label(
    State(service): State<Arc<Service>>,
    InPath(PlacePath { map, place }): InPath<PlacePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(Labelling { label, scope }): InBody<Labelling>,
) -> Result<Json<v1::SetLabelResponse>, HttpError> {
    let scope = match scope {
        LabelScope::Place => labels::LabelScope::Place,
        LabelScope::Space => labels::LabelScope::Space,
    };
    let set = service.labels.set(&format!("maps/{map}/places/{place}"), &label, scope).await?;
    Ok(Json(v1::SetLabelResponse { labels: labels(&map, set) }))
}

/// Takes a place's label away.
#[utoipa::path(delete, path = "/v1/maps/{map}/places/{place}/label", tag = "maps", params(PlacePath),
    responses((status = 200, description = "It has none any more.", body = v1::DeleteLabelResponse), Refusals))]
pub(super) async fn delete_label(
    State(service): State<Arc<Service>>,
    InPath(PlacePath { map, place }): InPath<PlacePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::DeleteLabelResponse>, HttpError> {
    service.labels.delete(&format!("maps/{map}/places/{place}")).await?;
    Ok(Json(v1::DeleteLabelResponse {}))
}

/// Which places of a map that is navigated by appearance can be matched from which, and the spaces that they form. Where
/// frames have come that are not in it yet, it waits for them.
#[utoipa::path(get, path = "/v1/maps/{map}/appearance-graph", tag = "maps", params(MapPath),
    responses((status = 200, description = "The graph.", body = v1::AppearanceGraph), Refusals))]
pub(super) async fn get_appearance_graph(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::AppearanceGraph>, HttpError> {
    Ok(Json(graph(service.appearance.get(&map_name(&map)).await?)))
}

/// What a place is to be called.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"label": "kitchen", "scope": "space"}))]
pub(super) struct Labelling {
    /// 1 to 63 characters, none of them a control character, no blank at either end.
    label: String,
    #[serde(default)]
    scope: LabelScope,
}

impl JsonBody for Labelling {
    const TAKES: &str = r#"{"label": "kitchen"}, with "scope": "space" for all places of its space"#;
}

/// On which places a label is put: on that one alone; or on all of the space that it is in at this moment, such as a room:
/// then a robot goes to the middle of it.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum LabelScope {
    #[default]
    Place,
    Space,
}
