//! Maps: create, list, get, delete; their places and loop closures.

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use topomap::mapper::{Mapper, MapperSettings};

use super::map_settings;
pub(crate) use super::map_settings::MapSettingsRequest;
use super::models::Page;
use super::names::{bad_page_token, check_id, map_in, page_size, session_name};
use super::{Service, now_ns};
use crate::error::ServiceError;
use crate::storage::{MapCounts, MapRow, SessionRow, StorageError, StoredFrame};

/// A map as people see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MapView {
    pub(crate) map: String,
    pub(crate) model: String,
    pub(crate) settings: MapperSettings,
    pub(crate) created_ns: i64,
    pub(crate) counts: MapCounts,
    /// Hash of all that the log decided, if asked for.
    pub(crate) state_hash: Option<String>,
}

/// Whether the state hash is wanted: it takes time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Detail {
    Basic,
    Full,
}

/// A place as people see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlaceView {
    pub(crate) place: PlaceId,
    pub(crate) looks: u8,
    pub(crate) words: u64,
    pub(crate) frames: Vec<FrameReference>,
    pub(crate) linked: Vec<PlaceId>,
}

/// A frame by its session and number.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameReference {
    /// `maps/{map}/sessions/{session}`.
    pub(crate) session: String,
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
}

/// An accepted loop closure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LoopClosureView {
    pub(crate) frame: FrameReference,
    pub(crate) matched: FrameReference,
    pub(crate) place: PlaceId,
    pub(crate) posterior: f64,
}

impl Service {
    pub(crate) async fn create_map(
        self: &Arc<Self>,
        map: &str,
        model: &str,
        settings: MapSettingsRequest,
    ) -> Result<MapView, ServiceError> {
        check_id("map name", map)?;
        let settings = settings.with_defaults()?;
        let model = self.find_model(model).await?;
        let loaded = self.loaded_model(&model.hash).await?;
        // Settings that no recognizer can be made of are refused now, not at the first frame.
        let check = move || Mapper::new(&loaded.model, settings).map(drop);
        let checked = tokio::task::spawn_blocking(check).await.map_err(ServiceError::internal)?;
        checked.map_err(ServiceError::invalid)?;
        let json = map_settings::to_json(&settings)?;
        let created = self.storage.create_map(map, &model.hash, &json, now_ns()).await;
        let row = created.map_err(|error| match error {
            StorageError::Exists => ServiceError::AlreadyExists {
                message: format!("there is a map {map} already; choose another name, or delete it first"),
            },
            StorageError::InUse => ServiceError::not_found("the model was deleted just now; name another"),
            error => error.into(),
        })?;
        self.view(row, Detail::Basic).await
    }

    pub(crate) async fn map(self: &Arc<Self>, name: &str, detail: Detail) -> Result<MapView, ServiceError> {
        let row = self.map_row(map_in(name)?).await?;
        self.view(row, detail).await
    }

    pub(crate) async fn list_maps(
        self: &Arc<Self>,
        size: u32,
        token: &str,
    ) -> Result<Page<MapView>, ServiceError> {
        let size = page_size(size)?;
        if !token.is_empty() {
            check_id("page token", token).map_err(|_| bad_page_token())?;
        }
        let mut rows = self.storage.maps(token, size + 1).await?;
        let more = rows.len() > size as usize;
        rows.truncate(size as usize);
        let next = rows.last().filter(|_| more).map_or_else(String::new, |row| row.name.clone());
        let mut items = Vec::with_capacity(rows.len());
        for row in rows {
            items.push(self.view(row, Detail::Basic).await?);
        }
        Ok(Page { items, next })
    }

    /// Deletes a map with all it holds. Streams into it end.
    pub(crate) async fn delete_map(self: &Arc<Self>, name: &str) -> Result<(), ServiceError> {
        let map = map_in(name)?;
        self.map_row(map).await?;
        let deleted = self.close_and_delete_map(map).await?;
        if deleted { Ok(()) } else { Err(no_such_map(map)) }
    }

    pub(crate) async fn list_places(
        self: &Arc<Self>,
        name: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<PlaceView>, ServiceError> {
        let (map, size) = (map_in(name)?, page_size(size)?);
        let from = if token.is_empty() { 0 } else { token.parse().map_err(|_| bad_page_token())? };
        let open = self.open_map(map).await?;
        let (places, total) = open.places(from, size).await?;
        let sessions = self.storage.sessions(open.id()).await?;
        let mut items = Vec::with_capacity(places.len());
        for place in places {
            let frames = self.storage.frames_at(open.id(), &place.frames).await?;
            items.push(PlaceView {
                place: place.place,
                looks: place.looks,
                words: place.words,
                frames: frames.iter().map(|frame| reference(map, &sessions, frame)).collect(),
                linked: place.linked,
            });
        }
        let end = from.saturating_add(size);
        Ok(Page { items, next: if end < total { end.to_string() } else { String::new() } })
    }

    pub(crate) async fn list_matches(
        &self,
        name: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<LoopClosureView>, ServiceError> {
        let (map, size) = (map_in(name)?, page_size(size)?);
        let row = self.map_row(map).await?;
        let after = if token.is_empty() { None } else { Some(token.parse().map_err(|_| bad_page_token())?) };
        let mut closures = self.storage.loop_closures(row.id, after, size + 1).await?;
        let more = closures.len() > size as usize;
        closures.truncate(size as usize);
        let sessions = self.storage.sessions(row.id).await?;
        let next =
            closures.last().filter(|_| more).map_or_else(String::new, |closure| closure.position.to_string());
        let view = |closure: &crate::storage::ClosureRow| LoopClosureView {
            frame: reference(map, &sessions, &closure.frame),
            matched: reference(map, &sessions, &closure.matched),
            place: closure.place,
            posterior: closure.posterior,
        };
        Ok(Page { items: closures.iter().map(view).collect(), next })
    }

    pub(super) async fn map_row(&self, map: &str) -> Result<MapRow, ServiceError> {
        self.storage.map(map).await?.ok_or_else(|| no_such_map(map))
    }

    async fn view(self: &Arc<Self>, row: MapRow, detail: Detail) -> Result<MapView, ServiceError> {
        let settings = map_settings::from_json(&row.settings)?;
        let counts = self.storage.map_counts(row.id).await?;
        let state_hash = match detail {
            Detail::Basic => None,
            Detail::Full => Some(self.open_map(&row.name).await?.state_hash().await?),
        };
        let MapRow { id: _, name, model, settings: _, created_ns } = row;
        Ok(MapView { map: name, model, settings, created_ns, counts, state_hash })
    }
}

fn no_such_map(map: &str) -> ServiceError {
    ServiceError::not_found(format_args!(
        "there is no map {map}; list the maps to see what there is, or create it"
    ))
}

pub(super) fn reference(map: &str, sessions: &[SessionRow], frame: &StoredFrame) -> FrameReference {
    let session = sessions.iter().find(|session| session.number == frame.session);
    FrameReference {
        session: session.map_or_else(String::new, |session| session_name(map, &session.name)),
        sequence: frame.sequence,
        stamp_ns: frame.stamp_ns,
    }
}
