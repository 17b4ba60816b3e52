//! A map as it was when a merge looked at it: read from the disk, beside whatever its robots do.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::ingest::Verifier;
use fabmap::appearance::PlaceId;
use tokio::runtime::Handle;
use topomap::ids::{FrameId, SessionId};
use topomap::log::MapEvent;
use topomap::mapper::Mapper;
use topomap::merging::{KnownMap, Layout, PairComparison, PlacePair};

use crate::error::{ArchiveError, ServiceError};
use crate::ingest::model::LoadedModel;
use crate::map_settings;
use crate::names::{frame_name, session_name};
use crate::open_map::{Recent, SeenFeatures, compare, no_such_map, stored_features};
use crate::storage::{MapId, MapRow, SessionRow, Storage, StorageError};

/// Frames whose features are kept in memory, of about 80 kB each: a place is compared with several.
const MOST_RECENT_FEATURES: usize = 512;

/// Where maps are read from, by those who may block.
#[derive(Clone, Copy)]
pub(super) struct Disk<'a> {
    pub(super) runtime: &'a Handle,
    pub(super) storage: &'a Storage,
}

/// A map with its log.
pub(super) struct ReadMap {
    pub(super) row: MapRow,
    /// Of its sessions, and of those that came from others: `maps/{map}/sessions/{session}`.
    session_names: HashMap<SessionId, String>,
    pub(super) mapper: Mapper,
    pub(super) log: Log,
}

/// A frame as users name it.
#[derive(Clone, Debug, Default)]
pub(super) struct ToldFrame {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`
    pub(super) name: String,
    /// What its robot calls it; empty if nothing.
    pub(super) note: String,
}

/// A map's log, of which some may have come from others.
#[derive(Clone, Debug, Default)]
pub(super) struct Log {
    pub(super) events: Vec<MapEvent>,
    /// Where the media of its frames are: from that position on those of a map, ascending.
    pieces: Vec<(FrameId, MapId)>,
}

impl ReadMap {
    /// Reads the log up to `events`, or all of it, and folds it. Blocks.
    pub(super) fn read(
        disk: Disk<'_>,
        row: MapRow,
        model: &LoadedModel,
        events: Option<u64>,
    ) -> Result<Self, ServiceError> {
        let Disk { runtime, storage } = disk;
        let name = row.name;
        let row = runtime.block_on(storage.map_of_id(row.id))?.ok_or_else(|| no_such_map(&name))?;
        let settings = map_settings::from_json(&row.settings)?.mapper;
        let mut mapper = Mapper::new(&model.model, settings).map_err(ServiceError::internal)?;
        let mut log = Log { events: Vec::new(), pieces: vec![(0, row.id)] };
        read_on(disk, row.id, model, events, &mut mapper, &mut log.events)?;
        mapper.relax();
        let sessions = runtime.block_on(storage.sessions(row.id))?;
        let named = |session: SessionRow| (session.number, session_name(&row.name, &session.name));
        let session_names = sessions.into_iter().map(named).collect();
        Ok(Self { row, session_names, mapper, log })
    }

    pub(super) fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, log: &self.log.events }
    }

    pub(super) fn layout(&self) -> Layout<'_> {
        let settings = self.mapper.settings();
        Layout { poses: self.mapper.poses(), noise: settings.odometry_noise, spacing: settings.place_spacing }
    }

    /// Takes in what another map's log has become.
    pub(super) fn take(&mut self, source: &ReadMap, events: Vec<MapEvent>) -> Result<(), ServiceError> {
        for event in &events {
            self.mapper.fold(event).map_err(ServiceError::internal)?;
        }
        self.mapper.relax();
        for (of_source, session) in joined_sessions(&source.log.events, &events) {
            let name = source.session_names.get(&of_source).cloned().unwrap_or_default();
            self.session_names.insert(session, name);
        }
        self.log.pieces.push((self.log.events.len() as u64, source.row.id));
        self.log.events.extend(events);
        Ok(())
    }

    /// A session's own name.
    pub(super) fn session(&self, number: SessionId) -> &str {
        let name = self.session_names.get(&number).and_then(|name| name.rsplit('/').next());
        name.unwrap_or_default()
    }

    /// A frame as users name it; empty if it is none. Blocks.
    pub(super) fn told_frame(&self, disk: Disk<'_>, frame: FrameId) -> Result<ToldFrame, ServiceError> {
        let Some(MapEvent::Frame(event)) = self.log.event(frame) else { return Ok(ToldFrame::default()) };
        let session = self.session_names.get(&event.session);
        let name = session.map_or_else(String::new, |session| frame_name(session, event.sequence));
        let mut note = String::new();
        if let Some((map, position)) = self.log.media_of(frame) {
            let notes = disk.runtime.block_on(disk.storage.notes(map, position..position + 1))?;
            note = notes.into_iter().next().map_or_else(String::new, |row| row.note);
        }
        Ok(ToldFrame { name, note })
    }
}

/// Sessions of a source, with what they are once its log is rewritten.
pub(super) fn joined_sessions<'a>(
    source: &'a [MapEvent],
    joined: &'a [MapEvent],
) -> impl Iterator<Item = (SessionId, SessionId)> + 'a {
    source.iter().zip(joined).filter_map(|(before, after)| match (before, after) {
        (&MapEvent::SessionOpened { session: before }, &MapEvent::SessionOpened { session: after }) => {
            Some((before, after))
        }
        _ => None,
    })
}

/// Places of a source, with what they are once its log is rewritten.
pub(super) fn joined_places<'a>(
    source: &'a [MapEvent],
    joined: &'a [MapEvent],
) -> impl Iterator<Item = (PlaceId, PlaceId)> + 'a {
    source.iter().zip(joined).filter_map(|(before, after)| match (before, after) {
        (MapEvent::Frame(before), MapEvent::Frame(after)) => before.decision.place.zip(after.decision.place),
        _ => None,
    })
}

/// Reads and folds what a log has beyond what was folded. Blocks.
pub(super) fn read_on(
    Disk { runtime, storage }: Disk<'_>,
    map: MapId,
    model: &LoadedModel,
    events: Option<u64>,
    mapper: &mut Mapper,
    log: &mut Vec<MapEvent>,
) -> Result<(), ServiceError> {
    let positions = log.len() as u64..events.unwrap_or(u64::MAX);
    let mut fold = |_: u64, event: MapEvent| {
        mapper.fold(&event).map_err(|error| StorageError::Damaged(error.to_string()))?;
        log.push(event);
        Ok(())
    };
    let words = model.model.vocabulary().len();
    Ok(runtime.block_on(storage.replay(map, positions, words, &mut fold))?)
}

impl Log {
    fn event(&self, frame: FrameId) -> Option<&MapEvent> {
        self.events.get(usize::try_from(frame).ok()?)
    }

    /// The map that keeps the media of a frame, and the frame's position there.
    fn media_of(&self, frame: FrameId) -> Option<(MapId, FrameId)> {
        let piece = self.pieces.partition_point(|&(from, _)| from <= frame).checked_sub(1)?;
        let (from, map) = self.pieces[piece];
        Some((map, frame - from))
    }
}

/// Frames of two maps, side by side.
pub(super) struct Between<'a> {
    pub(super) source: &'a Log,
    pub(super) target: &'a Log,
    pub(super) verifier: Verifier,
    disk: Disk<'a>,
    recent: Mutex<Recent<Option<SeenFeatures>, (MapId, FrameId)>>,
}

impl<'a> Between<'a> {
    pub(super) fn new(disk: Disk<'a>, source: &'a Log, target: &'a Log, verifier: Verifier) -> Self {
        let recent = Mutex::new(Recent::new(MOST_RECENT_FEATURES));
        Self { source, target, verifier, disk, recent }
    }

    fn features(&self, log: &Log, frame: FrameId) -> Result<Option<SeenFeatures>, ArchiveError> {
        let Some((map, position)) = log.media_of(frame) else { return Ok(None) };
        let recent = || self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(features) = recent().get((map, position)) {
            return Ok(features.clone());
        }
        let features = stored_features(self.disk.runtime, self.disk.storage, map, position)?;
        recent().keep((map, position), features.clone());
        Ok(features)
    }

    /// Compares the two frames of a pair. Blocks.
    pub(super) fn compare(&self, pair: &PlacePair) -> Result<PairComparison, ArchiveError> {
        let Some(current) = self.features(self.source, pair.source_frame)? else {
            return Ok(PairComparison::default());
        };
        let focal_length_widths = current.focal_length_widths();
        let earlier = self.features(self.target, pair.target_frame)?;
        let view = earlier.map(|earlier| compare(&self.verifier, &earlier, &current).view);
        Ok(PairComparison { view, focal_length_widths })
    }
}

/// Models are shared with those who serve robots.
pub(super) type Models = Vec<Arc<LoadedModel>>;
