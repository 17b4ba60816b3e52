//! What places are called, and how they hang together by appearance.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, PlacePath};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::appearance::{self as service, GraphView, LinkView, NodeView};
use crate::service::models::Page;
use crate::service::names::{map_name, place_name};
use crate::storage::LabelRow;

/// The places of a map that have a label, by number.
#[utoipa::path(get, path = "/v1/maps/{map}/labels", tag = "maps", params(MapPath, Paging),
    responses((status = 200, description = "A page of labels.", body = LabelList), Refusals))]
pub(super) async fn list_labels(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<LabelList>, HttpError> {
    let Page { items, next } = service.list_labels(&map_name(&map), page_size, &page_token).await?;
    Ok(Json(LabelList { labels: labels(&map, items), next_page_token: next }))
}

/// Puts a label on a place, in place of what it had; or on all places of its space.
#[utoipa::path(put, path = "/v1/maps/{map}/places/{place}/label", tag = "maps", params(PlacePath),
    request_body(content = Labelling, description = "The label, and how far it reaches."),
    responses((status = 200, description = "The places that were labelled.", body = Labelled), Refusals))]
pub(super) async fn set_label(
    State(service): State<Arc<Service>>,
    InPath(PlacePath { map, place }): InPath<PlacePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    labelling: Result<Json<Labelling>, JsonRejection>,
) -> Result<Json<Labelled>, HttpError> {
    let Json(Labelling { label, reach }) = labelling.map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; send {{\"label\": \"kitchen\"}}, with \"reach\": \"space\" for all places of its space, as \
             application/json",
            rejection.body_text()
        ))
    })?;
    let reach = match reach {
        LabelReach::Place => service::LabelReach::Place,
        LabelReach::Space => service::LabelReach::Space,
    };
    let set = service.set_label(&format!("maps/{map}/places/{place}"), &label, reach).await?;
    Ok(Json(Labelled { labels: labels(&map, set) }))
}

/// Takes a place's label away.
#[utoipa::path(delete, path = "/v1/maps/{map}/places/{place}/label", tag = "maps", params(PlacePath),
    responses((status = 200, description = "It has none any more.", body = Unlabelled), Refusals))]
pub(super) async fn delete_label(
    State(service): State<Arc<Service>>,
    InPath(PlacePath { map, place }): InPath<PlacePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Unlabelled>, HttpError> {
    service.delete_label(&format!("maps/{map}/places/{place}")).await?;
    Ok(Json(Unlabelled {}))
}

/// Which places of a map that is navigated by appearance can be matched from which, and the spaces that they form. Where
/// frames have come that are not in it yet, it waits for them.
#[utoipa::path(get, path = "/v1/maps/{map}/appearance-graph", tag = "maps", params(MapPath),
    responses((status = 200, description = "The graph.", body = AppearanceGraph), Refusals))]
pub(super) async fn get_appearance_graph(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<AppearanceGraph>, HttpError> {
    Ok(Json(service.appearance_graph(&map_name(&map)).await?.into()))
}

/// A page of labels.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct LabelList {
    labels: Vec<PlaceLabel>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// A place with its label.
#[derive(Debug, Serialize, ToSchema)]
struct PlaceLabel {
    /// `maps/{map}/places/{number}`
    #[schema(example = "maps/demo/places/17")]
    place: String,
    #[schema(example = "kitchen")]
    label: String,
}

/// What a place is to be called.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"label": "kitchen", "reach": "space"}))]
pub(super) struct Labelling {
    /// 1 to 63 characters, none of them a control character, no blank at either end.
    label: String,
    #[serde(default)]
    reach: LabelReach,
}

/// On which places a label is put: on that one alone; or on all of the space that it is in at this moment, such as a room:
/// then a robot goes to the middle of it.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum LabelReach {
    #[default]
    Place,
    Space,
}

/// The places that were labelled.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Labelled {
    labels: Vec<PlaceLabel>,
}

/// Nothing is left to say.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Unlabelled {}

/// A map without metres: places that panoramas show, and what these have in common.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct AppearanceGraph {
    /// `maps/{map}`
    #[schema(example = "maps/demo")]
    map: String,
    /// By number. Places that no panorama was taken at are none of the graph.
    nodes: Vec<AppearanceNode>,
    /// Each once.
    links: Vec<AppearanceLink>,
}

/// A place of an appearance graph.
#[derive(Debug, Serialize, ToSchema)]
struct AppearanceNode {
    place: u32,
    /// Convex space that it is in, such as a room; as the map grows, spaces may change.
    space: u32,
    /// Empty if it has none.
    label: String,
}

/// Two places that can be matched from each other.
#[derive(Debug, Serialize, ToSchema)]
struct AppearanceLink {
    /// The earlier of the two.
    from_place: u32,
    to_place: u32,
    /// Matches that one planar motion explains over the smaller number of features.
    #[schema(exclusive_minimum = 0.05, maximum = 1)]
    similarity: f64,
}

fn labels(map: &str, rows: Vec<LabelRow>) -> Vec<PlaceLabel> {
    let label = |LabelRow { place, label }| PlaceLabel { place: place_name(map, place), label };
    rows.into_iter().map(label).collect()
}

impl From<GraphView> for AppearanceGraph {
    fn from(view: GraphView) -> Self {
        let GraphView { map, nodes, links } = view;
        let node = |NodeView { place, space, label }| AppearanceNode { place, space, label };
        let link =
            |LinkView { from, to, similarity }| AppearanceLink { from_place: from, to_place: to, similarity };
        Self {
            map,
            nodes: nodes.into_iter().map(node).collect(),
            links: links.into_iter().map(link).collect(),
        }
    }
}
