use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use utoipa::IntoParams;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, Parameters, PlacePath, WordPath};
use crate::error::ServiceError;
use crate::names::map_name;
use crate::pages::Page;
use crate::service::Service;
use crate::wire::places::{listed_place, place as message, places_wanted, word_place};

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PlacesAsked {
    /// Most entries in one answer; 0 asks for the default.
    #[param(minimum = 0, maximum = 1000, default = 100, example = 100)]
    page_size: u32,
    /// `next_page_token` of the page before. Left out, the first page comes.
    page_token: String,
    /// Thins large maps along the way: only places whose number this divides. 0 and 1 leave none out.
    #[param(example = 1)]
    every: u32,
    /// Only places from this number on.
    from_place_number: u32,
    /// Only places up to this number.
    to_place_number: Option<u32>,
    /// Only places of this part that lie within `min_x_m` to `max_x_m` and `min_y_m` to `max_y_m`: give all five, or none.
    part: Option<u32>,
    /// Least x in metres, in the part's frame.
    min_x_m: Option<f64>,
    /// Largest x in metres.
    max_x_m: Option<f64>,
    /// Least y in metres.
    min_y_m: Option<f64>,
    /// Largest y in metres.
    max_y_m: Option<f64>,
}

impl Parameters for PlacesAsked {
    const TAKES: &str = "page_size=NUMBER, page_token=TOKEN, every=NUMBER, from_place_number=NUMBER, \
                         to_place_number=NUMBER, and part=NUMBER with min_x_m, max_x_m, min_y_m and max_y_m";
}

impl PlacesAsked {
    fn within(&self) -> Result<Option<v1::PlaceBounds>, ServiceError> {
        let Self { part, min_x_m, max_x_m, min_y_m, max_y_m, .. } = *self;
        match (part, min_x_m, max_x_m, min_y_m, max_y_m) {
            (None, None, None, None, None) => Ok(None),
            (Some(part), Some(min_x_m), Some(max_x_m), Some(min_y_m), Some(max_y_m)) => {
                Ok(Some(v1::PlaceBounds { part, min_x_m, min_y_m, max_x_m, max_y_m }))
            }
            _ => Err(ServiceError::invalid(
                "a rectangle is its part, min_x_m, max_x_m, min_y_m and max_y_m; give all five, or none",
            )),
        }
    }
}

/// The places of a map, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/places", tag = "maps", params(MapPath, PlacesAsked),
    responses((status = 200, description = "A page of places.", body = v1::ListPlacesResponse), Refusals))]
pub(super) async fn list_places(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(asked): InQuery<PlacesAsked>,
) -> Result<Json<v1::ListPlacesResponse>, HttpError> {
    let within = asked.within()?;
    let wanted = places_wanted(asked.every, asked.from_place_number, asked.to_place_number, within)?;
    let Page { items, next } =
        service.maps.places(&map_name(&map), wanted, asked.page_size, &asked.page_token).await?;
    let places = items.into_iter().map(|view| listed_place(&map, view)).collect();
    Ok(Json(v1::ListPlacesResponse { places, next_page_token: next }))
}

/// A place with its words, and the frames of those who were there.
#[utoipa::path(get, path = "/v1/maps/{map}/places/{place}", tag = "maps", params(PlacePath),
    responses((status = 200, description = "The place.", body = v1::Place), Refusals))]
pub(super) async fn get_place(
    State(service): State<Arc<Service>>,
    InPath(PlacePath { map, place }): InPath<PlacePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Place>, HttpError> {
    let view = service.maps.place(&format!("maps/{map}/places/{place}")).await?;
    Ok(Json(message(&map, view)))
}

/// The places that have shown a word, from the inverted index, by number.
#[utoipa::path(get, path = "/v1/maps/{map}/words/{word}/places", tag = "maps", params(WordPath, Paging),
    responses((status = 200, description = "A page of places.", body = v1::ListWordPlacesResponse), Refusals))]
pub(super) async fn list_word_places(
    State(service): State<Arc<Service>>,
    InPath(WordPath { map, word }): InPath<WordPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListWordPlacesResponse>, HttpError> {
    let Page { items, next } =
        service.maps.word_places(&map_name(&map), word.into(), page_size, &page_token).await?;
    let places = items.into_iter().map(word_place).collect();
    Ok(Json(v1::ListWordPlacesResponse { places, next_page_token: next }))
}
