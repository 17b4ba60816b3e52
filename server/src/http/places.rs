use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, PlacePath, WordPath};
use crate::names::map_name;
use crate::pages::Page;
use crate::service::Service;
use crate::wire::places::{listed_place, place as message, word_place};

/// The places of a map, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/places", tag = "maps", params(MapPath, Paging),
    responses((status = 200, description = "A page of places.", body = v1::ListPlacesResponse), Refusals))]
pub(super) async fn list_places(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListPlacesResponse>, HttpError> {
    let Page { items, next } = service.maps.places(&map_name(&map), page_size, &page_token).await?;
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
