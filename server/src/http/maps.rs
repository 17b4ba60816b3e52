use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Paging, Parameters};
use crate::names::map_name;
use crate::pages::Page;
use crate::service::Service;
use crate::service::maps::Detail;
use crate::wire::maps::{loop_closure, map as message};

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Viewing {
    /// `full` adds the state hash and what the map takes on the disk, which takes time.
    #[param(inline)]
    view: View,
}

#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum View {
    #[default]
    Basic,
    Full,
}

impl Parameters for Viewing {
    const TAKES: &str = "view=basic or view=full";
}

/// All maps, by name.
#[utoipa::path(get, path = "/v1/maps", tag = "maps", params(Paging),
    responses((status = 200, description = "A page of maps.", body = v1::ListMapsResponse), Refusals))]
pub(super) async fn list_maps(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListMapsResponse>, HttpError> {
    let Page { items, next } = service.maps.list(page_size, &page_token).await?;
    let maps = items.into_iter().map(message).collect();
    Ok(Json(v1::ListMapsResponse { maps, next_page_token: next }))
}

/// A map with all its settings.
#[utoipa::path(get, path = "/v1/maps/{map}", tag = "maps", params(MapPath, Viewing),
    responses((status = 200, description = "The map.", body = v1::Map), Refusals))]
pub(super) async fn get_map(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Viewing { view }): InQuery<Viewing>,
) -> Result<Json<v1::Map>, HttpError> {
    let detail = match view {
        View::Basic => Detail::Basic,
        View::Full => Detail::Full,
    };
    Ok(Json(message(service.maps.get(&map_name(&map), detail).await?)))
}

/// The loop closures of a map, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/loop-closures", tag = "maps", params(MapPath, Paging),
    responses((status = 200, description = "A page of loop closures.", body = v1::ListLoopClosuresResponse), Refusals))]
pub(super) async fn list_loop_closures(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListLoopClosuresResponse>, HttpError> {
    let Page { items, next } = service.maps.loop_closures(&map_name(&map), page_size, &page_token).await?;
    let loop_closures = items.into_iter().map(loop_closure).collect();
    Ok(Json(v1::ListLoopClosuresResponse { loop_closures, next_page_token: next }))
}
