use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use serde::{Deserialize, Serialize};

use super::HttpError;
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::maps::{Detail, FrameReference, LoopClosureView, MapView, PlaceView};
use crate::service::models::Page;
use crate::service::names::{map_name, model_name, place_name};
use crate::storage::MapCounts;

/// `?page_size=…&page_token=…`
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Paging {
    page_size: u32,
    page_token: String,
}

/// `?view=full`
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Viewing {
    view: View,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum View {
    #[default]
    Basic,
    Full,
}

/// The `{map}` of a path.
type Named = Result<Path<String>, PathRejection>;

fn named(path: Named) -> Result<String, ServiceError> {
    path.map(|Path(map)| map).map_err(|rejection| {
        ServiceError::invalid(format_args!("{}; a map name is plain ASCII", rejection.body_text()))
    })
}

type Asked<T> = Result<Query<T>, QueryRejection>;

fn asked<T>(query: Asked<T>) -> Result<T, ServiceError> {
    query.map(|Query(asked)| asked).map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; lists take page_size=NUMBER and page_token=TOKEN, a map takes view=basic or view=full",
            rejection.body_text()
        ))
    })
}

pub(super) async fn list(
    State(service): State<Arc<Service>>,
    query: Asked<Paging>,
) -> Result<Json<MapList>, HttpError> {
    let Paging { page_size, page_token } = asked(query)?;
    let Page { items, next } = service.list_maps(page_size, &page_token).await?;
    Ok(Json(MapList { maps: items.into_iter().map(Map::from).collect(), next_page_token: next }))
}

pub(super) async fn map(
    State(service): State<Arc<Service>>,
    path: Named,
    query: Asked<Viewing>,
) -> Result<Json<Map>, HttpError> {
    let map = named(path)?;
    let detail = match asked(query)?.view {
        View::Basic => Detail::Basic,
        View::Full => Detail::Full,
    };
    Ok(Json(service.map(&map_name(&map), detail).await?.into()))
}

pub(super) async fn places(
    State(service): State<Arc<Service>>,
    path: Named,
    query: Asked<Paging>,
) -> Result<Json<PlaceList>, HttpError> {
    let map = named(path)?;
    let Paging { page_size, page_token } = asked(query)?;
    let Page { items, next } = service.list_places(&map_name(&map), page_size, &page_token).await?;
    let places = items.into_iter().map(|view| Place::new(&map, view)).collect();
    Ok(Json(PlaceList { places, next_page_token: next }))
}

pub(super) async fn matches(
    State(service): State<Arc<Service>>,
    path: Named,
    query: Asked<Paging>,
) -> Result<Json<MatchList>, HttpError> {
    let map = named(path)?;
    let Paging { page_size, page_token } = asked(query)?;
    let Page { items, next } = service.list_matches(&map_name(&map), page_size, &page_token).await?;
    Ok(Json(MatchList { matches: items.into_iter().map(LoopClosure::from).collect(), next_page_token: next }))
}

#[derive(Debug, Serialize)]
pub(super) struct MapList {
    maps: Vec<Map>,
    next_page_token: String,
}

#[derive(Debug, Serialize)]
pub(super) struct Map {
    name: String,
    model: String,
    create_time_ns: i64,
    places: u64,
    links: u64,
    sessions: u64,
    frames: u64,
    loop_closures: u64,
    closure_threshold: f64,
    guard_frames: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    state_hash: Option<String>,
}

#[derive(Debug, Serialize)]
pub(super) struct PlaceList {
    places: Vec<Place>,
    next_page_token: String,
}

#[derive(Debug, Serialize)]
pub(super) struct Place {
    name: String,
    looks: u8,
    words: u64,
    frames: Vec<Frame>,
    linked: Vec<u32>,
}

#[derive(Debug, Serialize)]
pub(super) struct MatchList {
    matches: Vec<LoopClosure>,
    next_page_token: String,
}

#[derive(Debug, Serialize)]
pub(super) struct LoopClosure {
    frame: Frame,
    matched_frame: Frame,
    place: u32,
    posterior: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Frame {
    session: String,
    sequence: u64,
    stamp_ns: i64,
}

impl From<MapView> for Map {
    fn from(view: MapView) -> Self {
        let MapView { map, model, settings, created_ns, counts, state_hash } = view;
        let MapCounts { sessions, frames, loop_closures, places, links } = counts;
        Self {
            name: map_name(&map),
            model: model_name(&model),
            create_time_ns: created_ns,
            places,
            links,
            sessions,
            frames,
            loop_closures,
            closure_threshold: settings.closure_threshold,
            guard_frames: settings.guard_frames,
            state_hash,
        }
    }
}

impl Place {
    fn new(map: &str, view: PlaceView) -> Self {
        let PlaceView { place, looks, words, frames, linked } = view;
        let frames = frames.into_iter().map(Frame::from).collect();
        Self { name: place_name(map, place), looks, words, frames, linked }
    }
}

impl From<LoopClosureView> for LoopClosure {
    fn from(view: LoopClosureView) -> Self {
        let LoopClosureView { frame, matched, place, posterior } = view;
        Self { frame: frame.into(), matched_frame: matched.into(), place, posterior }
    }
}

impl From<FrameReference> for Frame {
    fn from(reference: FrameReference) -> Self {
        let FrameReference { session, sequence, stamp_ns } = reference;
        Self { session, sequence, stamp_ns }
    }
}
