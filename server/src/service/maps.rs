//! Maps: create, list, get, delete; their places and loop closures.

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use fabmap::observation::WordId;
use topomap::mapper::{Mapper, MapperSettings};
use topomap::relaxation::PlanarPose;

use super::map_settings;
pub(crate) use super::map_settings::{Keep, MapSettings, MapSettingsRequest, NavigationStrategy};
use super::map_writer::PlaceSummary;
pub(crate) use super::map_writer::WordPlace;
use super::models::Page;
use super::names::{bad_page_token, check_id, map_in, numbered_page, page_size, place_in, session_name};
use super::{Service, now_ns};
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::storage::{MapBytes, MapCounts, MapId, MapRow, SessionRow, StorageError, StoredFrame};

/// A map as people see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MapView {
    pub(crate) map: String,
    pub(crate) model: String,
    pub(crate) settings: MapSettings,
    pub(crate) created_ns: i64,
    pub(crate) counts: MapCounts,
    /// Hash of all that the log decided, if asked for.
    pub(crate) state_hash: Option<String>,
    /// What it takes on the disk, if asked for.
    pub(crate) bytes: Option<MapBytes>,
}

/// Whether the state hash and the weight are wanted: they take time.
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
    /// Words ever seen there with how many looks showed each, ascending by word.
    pub(crate) word_hits: Vec<(WordId, u8)>,
    pub(crate) frames: Vec<FrameReference>,
    pub(crate) linked: Vec<PlaceId>,
    /// `None` where nothing measured the way to any other place.
    pub(crate) pose: Option<PlacePose>,
}

/// Where a place is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlacePose {
    /// The lowest place of its part, whose frame the pose is in.
    pub(crate) part: PlaceId,
    pub(crate) pose: PlanarPose,
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
    /// By words and geometry together; `None` where nothing was verified.
    pub(crate) probability: Option<f64>,
}

impl Service {
    pub(crate) async fn create_map(
        self: &Arc<Self>,
        map: &str,
        model: &str,
        settings: MapSettingsRequest,
    ) -> Result<MapView, ServiceError> {
        check_id("map name", map)?;
        self.snapshots.check_unreserved(map)?;
        let settings = settings.with_defaults()?;
        let model = self.find_model(model).await?;
        let loaded = self.loaded_model(&model.hash).await?;
        check_recognizer(loaded, settings.mapper).await?;
        let json = map_settings::to_json(&settings)?;
        let created = self.storage.create_map(map, &model.hash, &json, now_ns()).await;
        let row = created.map_err(|error| match error {
            StorageError::Exists => map_exists(map),
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
        let from = numbered_page(token)?.unwrap_or(0);
        let open = self.open_map(map).await?;
        let (places, total) = open.places(from, size).await?;
        let end = from.saturating_add(size);
        let next = if end < total { end.to_string() } else { String::new() };
        Ok(Page { items: self.place_views(map, open.id(), places).await?, next })
    }

    /// A place by `maps/{map}/places/{number}`.
    pub(crate) async fn place(self: &Arc<Self>, name: &str) -> Result<PlaceView, ServiceError> {
        let (map, place) = place_in(name)?;
        let open = self.open_map(map).await?;
        let no_such_place = || {
            ServiceError::not_found(format_args!(
                "the map {map} has no place {place}; list its places to see what there is"
            ))
        };
        let place = open.place(place).await?.ok_or_else(no_such_place)?;
        self.place_views(map, open.id(), vec![place]).await?.pop().ok_or_else(no_such_place)
    }

    /// The places that have shown a word, by number.
    pub(crate) async fn list_word_places(
        self: &Arc<Self>,
        name: &str,
        word: WordId,
        size: u32,
        token: &str,
    ) -> Result<Page<WordPlace>, ServiceError> {
        let (map, size) = (map_in(name)?, page_size(size)?);
        let from = numbered_page(token)?.unwrap_or(0);
        let row = self.map_row(map).await?;
        let words = self.vocabulary_len(&row).await?;
        if word as usize >= words {
            return Err(ServiceError::invalid(format_args!(
                "there is no word {word}; the map's vocabulary has the words 0 to {}",
                words.saturating_sub(1)
            )));
        }
        let mut items = self.open_map_of(&row).await?.word_places(word, from, size + 1).await?;
        let next = items.get(size as usize).map_or_else(String::new, |next| next.place.to_string());
        items.truncate(size as usize);
        Ok(Page { items, next })
    }

    /// Goes on with another model over the same words.
    pub(crate) async fn rebind_map(
        self: &Arc<Self>,
        name: &str,
        model: &str,
    ) -> Result<MapView, ServiceError> {
        let map = map_in(name)?;
        let row = self.map_row(map).await?;
        let model = self.find_model(model).await?;
        let (loaded, before) = (self.loaded_model(&model.hash).await?, self.loaded_model(&row.model).await?);
        if loaded.words_hash != before.words_hash {
            return Err(ServiceError::precondition(format_args!(
                "the model models/{} has other words (words_hash {}) than the map (words_hash {}); a map can go on \
                 only with a model that was made over the same extractor and vocabulary",
                loaded.hash, loaded.words_hash, before.words_hash
            )));
        }
        let settings = map_settings::from_json(&row.settings)?.mapper;
        check_recognizer(loaded, settings).await?;
        if model.hash != row.model {
            self.close_and_rebind_map(map, model.hash).await?;
        }
        self.view(self.map_row(map).await?, Detail::Basic).await
    }

    /// Places with their frames as users name them, all looked up together.
    async fn place_views(
        &self,
        map: &str,
        id: MapId,
        places: Vec<PlaceSummary>,
    ) -> Result<Vec<PlaceView>, ServiceError> {
        let positions = places.iter().flat_map(|place| place.frames.iter().copied());
        let frames = self.storage.frames_by_position(id, positions.collect::<Vec<_>>()).await?;
        let sessions = self.storage.sessions(id).await?;
        let view = |summary: PlaceSummary| {
            let PlaceSummary { place, looks, word_hits, frames: positions, linked, pose } = summary;
            let found = positions.iter().filter_map(|position| frames.get(position));
            let frames = found.map(|frame| reference(map, &sessions, frame)).collect();
            PlaceView { place, looks, word_hits, frames, linked, pose }
        };
        Ok(places.into_iter().map(view).collect())
    }

    pub(crate) async fn list_matches(
        &self,
        name: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<LoopClosureView>, ServiceError> {
        let (map, size) = (map_in(name)?, page_size(size)?);
        let row = self.map_row(map).await?;
        let after = numbered_page(token)?;
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
            probability: closure.probability,
        };
        Ok(Page { items: closures.iter().map(view).collect(), next })
    }

    pub(super) async fn map_row(&self, map: &str) -> Result<MapRow, ServiceError> {
        self.storage.map(map).await?.ok_or_else(|| no_such_map(map))
    }

    async fn view(self: &Arc<Self>, row: MapRow, detail: Detail) -> Result<MapView, ServiceError> {
        let settings = map_settings::from_json(&row.settings)?;
        let counts = self.storage.map_counts(row.id).await?;
        let (state_hash, bytes) = match detail {
            Detail::Basic => (None, None),
            Detail::Full => {
                let state_hash = self.open_map_of(&row).await?.state_hash().await?;
                (Some(state_hash), Some(self.storage.map_bytes(row.id).await?))
            }
        };
        let MapRow { id: _, name, model, settings: _, created_ns, edition: _ } = row;
        Ok(MapView { map: name, model, settings, created_ns, counts, state_hash, bytes })
    }
}

/// Settings that no recognizer can be made of are refused now, not at the first frame.
pub(super) async fn check_recognizer(
    model: Arc<LoadedModel>,
    settings: MapperSettings,
) -> Result<(), ServiceError> {
    let check = move || Mapper::new(&model.model, settings).map(drop);
    let checked = tokio::task::spawn_blocking(check).await.map_err(ServiceError::internal)?;
    checked.map_err(ServiceError::invalid)
}

pub(super) fn map_exists(map: &str) -> ServiceError {
    ServiceError::AlreadyExists {
        message: format!("there is a map {map} already; choose another name, or delete it first"),
    }
}

pub(super) fn no_such_map(map: &str) -> ServiceError {
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
