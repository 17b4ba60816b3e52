use std::borrow::Cow;
use std::sync::Arc;

use axum::extract::State;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{IntoParams, PartialSchema, ToSchema};
use waypost_proto::v1;

use super::HttpError;
use super::bodies::{InBody, JsonBody};
use super::description::{BodyRefusals, Refusals};
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, Parameters};
use crate::names::map_name;
use crate::pages::Page;
use crate::service::Service;
use crate::service::maps::Detail;
use crate::service::tokens::Caller;
use crate::wire::maps::{loop_closure, map as message};
use crate::wire::settings::requested_settings;

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
    Extension(caller): Extension<Arc<Caller>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListMapsResponse>, HttpError> {
    let Page { items, next } = service.maps.list(&caller, page_size, &page_token).await?;
    let maps = items.into_iter().map(message).collect();
    Ok(Json(v1::ListMapsResponse { maps, next_page_token: next }))
}

/// Makes a map without places, which grows by a model. For administrators.
#[utoipa::path(post, path = "/v1/maps", tag = "maps",
    request_body(content = CreateMap, description = "What it is called, its model, and what is to be other than usual."),
    responses((status = 200, description = "The map.", body = v1::Map), Refusals, BodyRefusals))]
pub(super) async fn create_map(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(CreateMap { map_id, model, settings }): InBody<CreateMap>,
) -> Result<Json<v1::Map>, HttpError> {
    let Settings(settings) = settings.unwrap_or_default();
    let settings = requested_settings(settings)?;
    Ok(Json(message(service.maps.create(&caller, &map_id, &model, settings).await?)))
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

/// Deletes a map with all that it holds, for good. For administrators.
#[utoipa::path(delete, path = "/v1/maps/{map}", tag = "maps", params(MapPath),
    responses((status = 200, description = "It is gone.", body = v1::DeleteMapResponse), Refusals))]
pub(super) async fn delete_map(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::DeleteMapResponse>, HttpError> {
    service.rewriting.delete_map(&map_name(&map)).await?;
    Ok(Json(v1::DeleteMapResponse {}))
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

/// A map that is to be made.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"map_id": "office", "model": "site", "settings": {"keep": "images"}}))]
pub(super) struct CreateMap {
    /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
    map_id: String,
    /// Hash of the model. An unambiguous beginning of at least 6 digits, or a display name that only one model has, will do.
    /// If left out, the server's only model.
    #[serde(default)]
    model: String,
    #[serde(default)]
    settings: Option<Settings>,
}

impl JsonBody for CreateMap {
    const TAKES: &str = r#"{"map_id": "office"}"#;
}

/// What is left out or null has its default.
#[derive(Debug, Default, Deserialize)]
struct Settings(v1::MapSettings);

impl PartialSchema for Settings {
    /// The contract's, of which nothing needs to be there.
    fn schema() -> RefOr<Schema> {
        match v1::MapSettings::schema() {
            RefOr::T(Schema::Object(mut settings)) => {
                settings.required.clear();
                settings.into()
            }
            other => other,
        }
    }
}

impl ToSchema for Settings {
    fn name() -> Cow<'static, str> {
        "MapSettingsRequest".into()
    }
}
