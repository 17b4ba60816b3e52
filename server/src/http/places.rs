use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::HttpError;
use super::description::Refusals;
use super::geometry::Pose;
use super::maps::FrameReference;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, PlacePath, WordPath};
use crate::service::Service;
use crate::service::maps::{self, PlaceView};
use crate::service::models::Page;
use crate::service::names::{map_name, place_name};

/// The places of a map, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/places", tag = "maps", params(MapPath, Paging),
    responses((status = 200, description = "A page of places.", body = PlaceList), Refusals))]
pub(super) async fn list_places(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<PlaceList>, HttpError> {
    let Page { items, next } = service.list_places(&map_name(&map), page_size, &page_token).await?;
    let places = items.into_iter().map(|view| Place::listed(&map, view)).collect();
    Ok(Json(PlaceList { places, next_page_token: next }))
}

/// A place with its words, and the frames of those who were there.
#[utoipa::path(get, path = "/v1/maps/{map}/places/{place}", tag = "maps", params(PlacePath),
    responses((status = 200, description = "The place.", body = Place), Refusals))]
pub(super) async fn get_place(
    State(service): State<Arc<Service>>,
    InPath(PlacePath { map, place }): InPath<PlacePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Place>, HttpError> {
    Ok(Json(Place::new(&map, service.place(&format!("maps/{map}/places/{place}")).await?)))
}

/// The places that have shown a word, from the inverted index, by number.
#[utoipa::path(get, path = "/v1/maps/{map}/words/{word}/places", tag = "maps", params(WordPath, Paging),
    responses((status = 200, description = "A page of places.", body = WordPlaceList), Refusals))]
pub(super) async fn list_word_places(
    State(service): State<Arc<Service>>,
    InPath(WordPath { map, word }): InPath<WordPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<WordPlaceList>, HttpError> {
    let Page { items, next } =
        service.list_word_places(&map_name(&map), word, page_size, &page_token).await?;
    let places = items.into_iter().map(WordPlace::from).collect();
    Ok(Json(WordPlaceList { places, next_page_token: next }))
}

/// A page of places.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct PlaceList {
    places: Vec<Place>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// A location with an appearance.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Place {
    /// `maps/{map}/places/{number}`
    #[schema(example = "maps/demo/places/0")]
    name: String,
    /// How often its appearance was looked at; older looks are halved away.
    #[schema(maximum = 15)]
    looks: u8,
    /// Different words ever seen there.
    words: u64,
    /// Frames that it learnt from, oldest first; at most the latest 100.
    frames: Vec<FrameReference>,
    /// Places that it is linked with, as numbers.
    linked: Vec<u32>,
    /// By word. Not in lists.
    #[schema(required)]
    word_hits: Option<Vec<PlaceWord>>,
    /// Where it is, by odometry and loop closures; null where nothing measured the way to any other place.
    #[schema(required)]
    pose: Option<PlacePose>,
}

/// Where a place is.
#[derive(Debug, Serialize, ToSchema)]
struct PlacePose {
    /// The lowest place of the part of the map that measured ways join it with; that one's pose, when it was made, is
    /// the part's frame.
    part: u32,
    /// `base_link` there, seen from above.
    pose: Pose,
}

/// A word of a place.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
struct PlaceWord {
    word: u32,
    /// In how many of the place's looks it was seen.
    hits: u8,
}

/// A page of places that have shown a word.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct WordPlaceList {
    places: Vec<WordPlace>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// A place that has shown a word.
#[derive(Debug, Serialize, ToSchema)]
struct WordPlace {
    place: u32,
    /// In how many of the place's looks the word was seen.
    hits: u8,
    looks: u8,
}

impl Place {
    fn new(map: &str, view: PlaceView) -> Self {
        let PlaceView { place, looks, word_hits, frames, linked, pose } = view;
        Self {
            name: place_name(map, place),
            looks,
            words: word_hits.len() as u64,
            frames: frames.into_iter().map(FrameReference::from).collect(),
            linked,
            word_hits: Some(word_hits.into_iter().map(|(word, hits)| PlaceWord { word, hits }).collect()),
            pose: pose
                .map(|maps::PlacePose { part, pose }| PlacePose { part, pose: pose.on_the_ground().into() }),
        }
    }

    /// As it is in a list.
    fn listed(map: &str, view: PlaceView) -> Self {
        Self { word_hits: None, ..Self::new(map, view) }
    }
}

impl From<maps::WordPlace> for WordPlace {
    fn from(found: maps::WordPlace) -> Self {
        let maps::WordPlace { place, hits, looks } = found;
        Self { place, hits, looks }
    }
}
