//! Maps: create, list, get; their places and loop closures.

mod extent;

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use fabmap::observation::WordId;
use tokio::runtime::Handle;
use topomap::mapper::Mapper;
use topomap::settings::MapperSettings;

pub(crate) use self::extent::MapExtent;
use super::corrections::{CorrectionCounts, CorrectionView, Corrections};
use super::map_names::{MapNames, map_exists};
use super::models::Models;
use super::tokens::Caller;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::ingest::model::{LoadedModel, LoadedModels};
use crate::map_settings::{self, MapSettings};
use crate::names::{check_id, map_in, place_in};
use crate::open_map::OpenMaps;
use crate::open_map::answers::{FrameReference, PlacePose, PlaceSummary, WordPlace, reference};
pub(crate) use crate::open_map::{PlaceBounds, PlacesWanted};
use crate::pages::{Page, named_page, numbered_page, page_after, page_from, page_size, rows_of_page};
use crate::storage::{ClosureRow, MapId, MapRow, Storage, StorageError};
pub(crate) use crate::storage::{MapBytes, MapCounts};

/// A map as people see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MapView {
    pub(crate) map: String,
    pub(crate) model: String,
    pub(crate) settings: MapSettings,
    pub(crate) created_ns: i64,
    pub(crate) counts: MapCounts,
    pub(crate) corrections: CorrectionCounts,
    /// Hash of all that the log decided, if asked for.
    pub(crate) state_hash: Option<String>,
    /// What it takes on the disk, if asked for.
    pub(crate) bytes: Option<MapBytes>,
    /// How far it reaches, if asked for and measured.
    pub(crate) extent: Option<MapExtent>,
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

/// An accepted loop closure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LoopClosureView {
    pub(crate) frame: FrameReference,
    pub(crate) matched: FrameReference,
    pub(crate) place: PlaceId,
    pub(crate) posterior: f64,
    /// By words and geometry together; `None` where nothing was verified.
    pub(crate) probability: Option<f64>,
    /// Who withdrew it, if somebody did.
    pub(crate) correction: Option<CorrectionView>,
}

/// Maps: made, listed, read. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Maps {
    pub(super) storage: Storage,
    pub(super) models: Models,
    pub(super) loaded: LoadedModels,
    pub(super) open_maps: OpenMaps,
    pub(super) names: MapNames,
}

impl Maps {
    /// Makes an empty map; of the server's only model, if `model` is empty.
    pub(crate) async fn create(
        &self,
        caller: &Caller,
        map: &str,
        model: &str,
        settings: MapSettings,
    ) -> Result<MapView, ServiceError> {
        caller.check_map(check_id("map name", map)?)?;
        self.names.check_unreserved(map)?;
        let model = self.models.find_or_only(model).await?;
        let loaded = self.loaded.get(&model.hash).await?;
        check_recognizer(loaded, settings.mapper).await?;
        let json = map_settings::to_json(&settings)?;
        let created =
            self.storage.create_map(map, &model.hash, &json, now_ns(), caller.token.as_deref()).await;
        let row = created.map_err(|error| match error {
            StorageError::Exists => map_exists(map),
            StorageError::InUse => ServiceError::not_found("the model was deleted just now; name another"),
            error => error.into(),
        })?;
        self.view(row, Detail::Basic).await
    }

    pub(crate) async fn get(&self, name: &str, detail: Detail) -> Result<MapView, ServiceError> {
        let row = self.open_maps.row(map_in(name)?).await?;
        self.view(row, detail).await
    }

    /// Those that the caller reaches, by name.
    pub(crate) async fn list(
        &self,
        caller: &Caller,
        size: u32,
        token: &str,
    ) -> Result<Page<MapView>, ServiceError> {
        let size = page_size(size)?;
        let read = |after: String| async move { self.storage.maps(&after, size + 1).await };
        let name = |row: &MapRow| row.name.clone();
        let reached = |row: &MapRow| caller.reach.has(&row.name);
        let mut rows = rows_of_page(size, named_page(token)?, read, name, reached).await?;
        let more = rows.len() > size as usize;
        rows.truncate(size as usize);
        let next = rows.last().filter(|_| more).map_or_else(String::new, |row| page_after(&row.name));
        let mut items = Vec::with_capacity(rows.len());
        for row in rows {
            items.push(self.view(row, Detail::Basic).await?);
        }
        Ok(Page { items, next })
    }

    /// The places that are wanted, by number; those of a page begin where its token says.
    pub(crate) async fn places(
        &self,
        name: &str,
        wanted: PlacesWanted,
        size: u32,
        token: &str,
    ) -> Result<Page<PlaceView>, ServiceError> {
        let map = map_in(name)?;
        let size = page_size(size)?;
        let from = numbered_page(token)?.map_or(wanted.from, PlaceId::new);
        let open = self.open_maps.open(map).await?;
        let (places, next) = open.places(PlacesWanted { from, ..wanted }, size).await?;
        let next = next.map_or_else(String::new, page_from);
        Ok(Page { items: self.place_views(map, open.id(), places).await?, next })
    }

    /// A place by `maps/{map}/places/{number}`.
    pub(crate) async fn place(&self, name: &str) -> Result<PlaceView, ServiceError> {
        let (map, place) = place_in(name)?;
        let open = self.open_maps.open(map).await?;
        let no_such_place = || {
            ServiceError::not_found(format_args!(
                "the map {map} has no place {place}; list its places to see what there is"
            ))
        };
        let place = open.place(PlaceId::new(place)).await?.ok_or_else(no_such_place)?;
        self.place_views(map, open.id(), vec![place]).await?.pop().ok_or_else(no_such_place)
    }

    /// The places that have shown a word, by number.
    pub(crate) async fn word_places(
        &self,
        name: &str,
        word: WordId,
        size: u32,
        token: &str,
    ) -> Result<Page<WordPlace>, ServiceError> {
        let map = map_in(name)?;
        let size = page_size(size)?;
        let from = numbered_page(token)?.unwrap_or(0);
        let row = self.open_maps.row(map).await?;
        let words = self.loaded.get(&row.model).await?.model.vocabulary().len();
        if word.index() >= words {
            return Err(ServiceError::invalid(format_args!(
                "there is no word {word}; the map's vocabulary has the words 0 to {}",
                words.saturating_sub(1)
            )));
        }
        let mut items =
            self.open_maps.open_of(&row).await?.word_places(word, PlaceId::new(from), size + 1).await?;
        let next = items.get(size as usize).map_or_else(String::new, |next| page_from(next.place));
        items.truncate(size as usize);
        Ok(Page { items, next })
    }

    /// Goes on with another model over the same words.
    pub(crate) async fn rebind(&self, name: &str, model: &str) -> Result<MapView, ServiceError> {
        let map = map_in(name)?;
        let row = self.open_maps.row(map).await?;
        let model = self.models.find(model).await?;
        let loaded = self.loaded.get(&model.hash).await?;
        let before = self.loaded.get(&row.model).await?;
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
            let storage = self.storage.clone();
            let id = row.id;
            let rebind = move |runtime: &Handle| match runtime.block_on(storage.rebind_map(id, &model.hash)) {
                Ok(()) => Ok(()),
                Err(StorageError::InUse) => {
                    Err(ServiceError::not_found("the model was deleted just now; name another"))
                }
                Err(error) => Err(error.into()),
            };
            self.open_maps.with_closed(map, rebind).await?;
        }
        self.view(self.open_maps.row(map).await?, Detail::Basic).await
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

    pub(crate) async fn loop_closures(
        &self,
        name: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<LoopClosureView>, ServiceError> {
        let map = map_in(name)?;
        let size = page_size(size)?;
        let row = self.open_maps.row(map).await?;
        let after = numbered_page(token)?;
        let mut closures = self.storage.loop_closures(row.id, after, size + 1).await?;
        let more = closures.len() > size as usize;
        closures.truncate(size as usize);
        let sessions = self.storage.sessions(row.id).await?;
        let next =
            closures.last().filter(|_| more).map_or_else(String::new, |closure| page_from(closure.position));
        let frames = closures.iter().map(|closure| closure.position).collect();
        let corrections = Corrections::read(&self.storage, row.id).await?;
        let mut withdrawals = corrections.withdrawals(&self.storage, &row, frames).await?;
        let view = |closure: &ClosureRow| LoopClosureView {
            frame: reference(map, &sessions, &closure.frame),
            matched: reference(map, &sessions, &closure.matched),
            place: PlaceId::new(closure.place),
            posterior: closure.posterior,
            probability: closure.probability,
            correction: withdrawals.remove(&closure.position),
        };
        Ok(Page { items: closures.iter().map(view).collect(), next })
    }

    async fn view(&self, row: MapRow, detail: Detail) -> Result<MapView, ServiceError> {
        let settings = map_settings::from_json(&row.settings)?;
        let counts = self.storage.map_counts(row.id).await?;
        let corrections = Corrections::read(&self.storage, row.id).await?.counts();
        let (state_hash, bytes, extent) = match detail {
            Detail::Basic => (None, None, None),
            Detail::Full => {
                let open = self.open_maps.open_of(&row).await?;
                let extent = MapExtent::of(&*open.poses().await?);
                (Some(open.state_hash().await?), Some(self.storage.map_bytes(row.id).await?), extent)
            }
        };
        let MapRow { id: _, name, model, settings: _, created_ns, edition: _ } = row;
        Ok(MapView { map: name, model, settings, created_ns, counts, corrections, state_hash, bytes, extent })
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
