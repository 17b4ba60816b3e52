//! Proves that a file is a whole snapshot, and its log one of its model and settings, before anything
//! is stored.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::fs::File;
use std::io::{BufReader, Seek};
use std::ops::ControlFlow;

use fabmap::model::{ContentHash, Model};
use topomap::evidence::Match;
use topomap::ids::SessionId;
use topomap::log::{
    Confirmation, Correction, CorrectionEvent, Decision, FrameEvent, MapEvent, MeasuredEvent, Reason,
    Withdrawal,
};
use topomap::mapper::Mapper;

use super::format::{MapRecord, Record, SnapshotError, SnapshotReader};
use crate::error::ServiceError;
use crate::ingest::FeatureRecord;
use crate::ingest::model::LoadedModel;
use crate::map_settings;
use crate::names::check_id;
use crate::service::labels::check_label;
use crate::service::models::{check_display_name, row_of};
use crate::service::sessions::check_note;
use crate::storage::{FormerModelRow, ImportedMap, LabelRow, MediaRow, MediumKind, NoteRow, StoredSession};

/// Why a snapshot was not taken.
#[derive(Debug)]
pub(super) enum NotTaken {
    Cancelled,
    Refused(ServiceError),
}

/// Hears how much of the file was read, in bytes, and says whether to go on.
pub(super) type Progress<'a> = &'a mut dyn FnMut(u64) -> ControlFlow<()>;

/// A snapshot from its first byte on.
pub(super) fn reader(file: &File) -> Result<SnapshotReader<BufReader<&File>>, NotTaken> {
    let mut file = file;
    file.rewind().map_err(ServiceError::internal)?;
    Ok(SnapshotReader::open(BufReader::with_capacity(1 << 20, file))?)
}

/// The map that a snapshot is of, by its first record alone.
pub(super) fn map_of(file: &File) -> Result<MapRecord, NotTaken> {
    match reader(file)?.next()? {
        Some(Record::Map(map)) => Ok(map),
        // The reader takes no other record first.
        Some(_) | None => Err(refused("it does not begin with a map")),
    }
}

/// Checks the whole file; gives all of it but log, media, labels and notes, with `name` as the map's name.
pub(super) fn check(file: &File, name: &str, progress: Progress<'_>) -> Result<ImportedMap, NotTaken> {
    check_sum(file, progress)?;
    let mut snapshot = reader(file)?;
    let (Some(Record::Map(map)), Some(Record::Model { display_name, file })) =
        (snapshot.next()?, snapshot.next()?)
    else {
        return Err(refused("it does not begin with a map and its model"));
    };
    let MapRecord { name: _, model: hash, settings, created_ns } = map;
    let model = Model::from_bytes(&file).map_err(|error| refused(format_args!("its model: {error}")))?;
    let LoadedModel { model, .. } = LoadedModel::new(model)?;
    let display_name = check_display_name(&display_name)?;
    let model_row = row_of(&model, display_name, &file);
    if model_row.hash != hash {
        return Err(refused(format_args!(
            "it names the model {hash} and holds the model {}; export the map again",
            model_row.hash
        )));
    }
    let mut log = Log::new(&model, &settings)?;
    let mut former_models = Vec::new();
    let mut sessions = Vec::new();
    while let Some(record) = snapshot.next()? {
        match record {
            Record::FormerModel(former) => former_models.push(former),
            Record::Session(session) => sessions.push(session),
            Record::Event { position, event } => log.take(position, &event)?,
            Record::Medium(medium) => log.check_medium(&medium)?,
            Record::Label(label) => log.check_label(&label)?,
            Record::Note(note) => log.check_note(&note)?,
            Record::Map(_) | Record::Model { .. } => return Err(refused("it holds more than one map")),
        }
        go_on(progress(snapshot.bytes()))?;
    }
    log.check_former_models(&former_models)?;
    log.check_sessions(&sessions)?;
    let kept = log.kept;
    let name = name.to_owned();
    Ok(ImportedMap {
        name,
        model: model_row,
        model_file: file,
        settings,
        created_ns,
        former_models,
        sessions,
        kept,
    })
}

/// Reads it all once, so that what is damaged is called so, whatever the damage would look like.
fn check_sum(file: &File, progress: Progress<'_>) -> Result<(), NotTaken> {
    let mut snapshot = reader(file)?;
    while snapshot.next()?.is_some() {
        go_on(progress(snapshot.bytes()))?;
    }
    Ok(())
}

fn go_on(answer: ControlFlow<()>) -> Result<(), NotTaken> {
    match answer {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(NotTaken::Cancelled),
    }
}

/// A log as it is folded, event by event. A checksum says that a file is as it was written, not that
/// a Waypost server wrote it.
struct Log {
    mapper: Mapper,
    words: usize,
    /// Per position: the session of the frame that it is, if it is one.
    frames: Vec<Option<SessionId>>,
    /// What each session is to keep, in bytes.
    kept: BTreeMap<SessionId, u64>,
}

impl Log {
    fn new(model: &Model, settings: &str) -> Result<Self, NotTaken> {
        let settings = map_settings::from_json(settings).map_err(|_| {
            refused("its settings are not known to this server; import it with the version that exported it")
        })?;
        let mapper = Mapper::new(model, settings.mapper)
            .map_err(|error| refused(format_args!("its settings: {error}")))?;
        Ok(Self { mapper, words: model.vocabulary().len(), frames: Vec::new(), kept: BTreeMap::new() })
    }

    fn take(&mut self, position: u64, event: &[u8]) -> Result<(), NotTaken> {
        let wrong = |why: &dyn Display| refused(format_args!("event {position} of its log: {why}"));
        let event = MapEvent::from_bytes(event, self.words).map_err(|error| wrong(&error))?;
        match &event {
            MapEvent::Frame(frame) => self.check_frame(frame).map_err(|why| wrong(&why))?,
            MapEvent::Measured(measured) => {
                let MeasuredEvent { frame, earlier, .. } = measured.as_ref();
                if ![frame, earlier].into_iter().all(|position| self.is_frame(*position)) {
                    return Err(wrong(&"it measures between frames that are none"));
                }
            }
            MapEvent::Corrected(corrected) => self.check_correction(corrected).map_err(|why| wrong(&why))?,
            MapEvent::SessionOpened { .. } => {}
        }
        self.mapper.fold(&event).map_err(|error| wrong(&error))?;
        self.frames.push(match &event {
            MapEvent::Frame(frame) => Some(frame.session),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
        });
        // As it will be stored, whatever version the file has.
        *self.kept.entry(event.session()).or_default() += event.to_bytes().len() as u64;
        Ok(())
    }

    /// What the fold takes on trust, because no server logs anything else.
    fn check_frame(&self, event: &FrameEvent) -> Result<(), &'static str> {
        let FrameEvent { session, sequence, decision, new_place_posterior, proposal, belief, .. } = event;
        let Decision { reason, place, posterior, closure } = decision;
        let places = self.mapper.map().places().len() as u64;
        let created = place.is_some_and(|place| u64::from(place) == places);
        let last = self.mapper.map().session(*session).and_then(|session| session.last_sequence);
        if last.is_some_and(|last| *sequence <= last) {
            return Err("its sequence number does not rise");
        }
        let agrees = match reason {
            // What was at a place that is no more is somewhere new, at none.
            Reason::NewPlace => created || place.is_none(),
            Reason::BelowThreshold | Reason::GeometryRefused => created,
            Reason::SamePlace | Reason::LoopClosure => place.is_some() && !created,
            Reason::TooFewWords => place.is_none(),
        };
        if !agrees {
            return Err("its place is not one of its reason");
        }
        let matched = |found: &Match| {
            u64::from(found.place) < places && self.is_frame(found.frame) && !found.log_odds.is_nan()
        };
        if !closure.iter().chain(proposal).all(matched) {
            return Err("it matches a frame that was not there");
        }
        let beliefs = belief.places.iter().map(|&(_, probability)| probability);
        let matches = closure.iter().chain(proposal).map(|found| found.posterior);
        let own = [*posterior, *new_place_posterior, belief.new_place, belief.remainder];
        if !own.into_iter().chain(beliefs).chain(matches).all(|p| (0.0..=1.0 + 1e-9).contains(&p)) {
            return Err("it has a probability that is none");
        }
        let known = places + u64::from(created);
        if !belief.places.iter().all(|&(place, _)| u64::from(place) < known) {
            return Err("it believes in a place that does not exist");
        }
        Ok(())
    }

    fn check_correction(&self, event: &CorrectionEvent) -> Result<(), &'static str> {
        let are_frames = match &event.correction {
            Correction::Withdrawn(withdrawal) => {
                let Withdrawal { frame, earlier, frames, .. } = withdrawal.as_ref();
                frames.is_sorted()
                    && frames.contains(frame)
                    && frames.iter().chain([earlier]).all(|&frame| self.is_frame(frame))
            }
            Correction::Confirmed(Confirmation { frame, earlier, link: _ }) => {
                self.is_frame(*frame) && self.is_frame(*earlier)
            }
            Correction::Undone(_) => true,
        };
        if are_frames { Ok(()) } else { Err("it corrects frames that are none") }
    }

    fn is_frame(&self, position: u64) -> bool {
        self.session_of(position).is_some()
    }

    /// The session of a frame.
    fn session_of(&self, position: u64) -> Option<SessionId> {
        usize::try_from(position).ok().and_then(|position| self.frames.get(position).copied().flatten())
    }

    fn check_note(&self, row: &NoteRow) -> Result<(), NotTaken> {
        let NoteRow { position, note } = row;
        if note.is_empty() || !self.is_frame(*position) {
            return Err(refused(format_args!("it calls frame {position} {note:?}, which does not exist")));
        }
        Ok(check_note(note)?)
    }

    fn check_medium(&mut self, medium: &MediaRow) -> Result<(), NotTaken> {
        let MediaRow { position, kind, content } = medium;
        let Some(session) = self.session_of(*position) else {
            return Err(refused(format_args!("it holds an image of frame {position}, which does not exist")));
        };
        let features = match kind {
            MediumKind::Features => FeatureRecord::from_bytes(content).map(drop),
            MediumKind::Image | MediumKind::Thumbnail => Ok(()),
        };
        features.map_err(|error| refused(format_args!("the features of frame {position}: {error}")))?;
        *self.kept.entry(session).or_default() += content.len() as u64;
        Ok(())
    }

    fn check_label(&self, row: &LabelRow) -> Result<(), NotTaken> {
        let LabelRow { place, label } = row;
        if self.mapper.map().places().get(place.index()).is_none() {
            return Err(refused(format_args!("it calls the place {place} {label:?}, which does not exist")));
        }
        Ok(check_label(label)?)
    }

    fn check_former_models(&self, former_models: &[FormerModelRow]) -> Result<(), NotTaken> {
        let possible = |former: &FormerModelRow| {
            former.until_events <= self.mapper.map().events() && former.model.parse::<ContentHash>().is_ok()
        };
        if former_models.iter().all(possible) { Ok(()) } else { Err(refused("a former model is none")) }
    }

    /// Every session of the log has a name, and no other has.
    fn check_sessions(&self, sessions: &[StoredSession]) -> Result<(), NotTaken> {
        let mut names = BTreeSet::new();
        for (expected, StoredSession { number, name, camera: _, opened_ns: _ }) in (0..).zip(sessions) {
            check_id("session name", name)?;
            if *number != expected || !names.insert(name) {
                return Err(refused(format_args!(
                    "its session {name} is there twice, or out of order, or damaged"
                )));
            }
        }
        if sessions.len() as u64 == u64::from(self.mapper.map().next_session()) {
            return Ok(());
        }
        Err(refused("its sessions are not those of its log"))
    }
}

fn refused(why: impl Display) -> NotTaken {
    ServiceError::invalid(format_args!("the snapshot cannot be imported: {why}; fetch or export it again"))
        .into()
}

impl From<ServiceError> for NotTaken {
    fn from(error: ServiceError) -> Self {
        Self::Refused(error)
    }
}

impl From<SnapshotError> for NotTaken {
    fn from(error: SnapshotError) -> Self {
        match error {
            // These say themselves how to mend it.
            SnapshotError::Decode(error) => {
                ServiceError::invalid(format_args!("the snapshot cannot be imported: {error}")).into()
            }
            SnapshotError::Source(error) => ServiceError::internal(error).into(),
        }
    }
}
