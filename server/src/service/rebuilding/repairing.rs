//! A damaged map made anew, from what is left of it and from an earlier copy.

use std::collections::HashMap;
use std::ops::Range;

use fabmap::appearance::PlaceId;
use topomap::ids::FrameId;
use topomap::log::MapEvent;

use super::resending::{KeptFrame, Resending, Streams, WithoutContent};
use super::{EVENTS_PAGE, Rebuilding, by_position};
use crate::error::ServiceError;
use crate::names::{check_id, map_in};
use crate::service::jobs::{JobOutcome, JobReporter, JobStatus, Stopped};
use crate::service::tokens::Caller;
use crate::storage::{JobKind, LabelRow, MapId, MapRow, Salvaged, StorageError};

/// Frames of a place that are asked where it is now.
const WITNESSES: u32 = 16;

/// Above every position of a log.
const END_OF_LOG: FrameId = i64::MAX as FrameId;

/// What is lost that is told by name.
const MOST_TOLD: usize = 20;

/// A damaged map, and what its frames are.
struct Repair {
    /// Whose the new map is.
    caller: Caller,
    resending: Resending,
    copy: Option<Copy>,
    /// Of the model that both have.
    words: usize,
}

/// The map as it was earlier.
struct Copy {
    row: MapRow,
    /// Of its log: the map may have grown since.
    events: u64,
}

/// What could not be brought back.
#[derive(Debug, Default)]
struct Losses {
    events: Vec<String>,
    /// What robots measured, and people corrected: said of frames of the damaged map.
    measured: u64,
    corrected: u64,
    labels: Vec<String>,
    /// What is kept of frames beside the log.
    beside: Vec<String>,
}

impl Rebuilding {
    /// Begins to repair a map into a new one. If that was begun before and cut off, it goes on where it was.
    pub(crate) async fn start_repair(
        &self,
        caller: &Caller,
        name: &str,
        into: &str,
        copy: &str,
    ) -> Result<JobStatus, ServiceError> {
        let (damaged, into) = (map_in(name)?, check_id("map name", into)?.to_owned());
        caller.check_map(damaged)?;
        caller.check_map(&into)?;
        let source = self.maps.open_maps.row(damaged).await?;
        let copy = match copy {
            "" => None,
            name => {
                let copy = map_in(name)?;
                caller.check_map(copy)?;
                Some(self.maps.open_maps.row(copy).await?)
            }
        };
        if let Some(copy) = copy.as_ref().filter(|copy| copy.id == source.id || copy.model != source.model) {
            return Err(ServiceError::precondition(format_args!(
                "the map {} is no earlier copy of {damaged}: import a snapshot of {damaged} under another name, and give that",
                copy.name
            )));
        }
        let model = self.maps.loaded.get(&source.model).await?;
        self.was_begun(JobKind::RepairMap, &source, &source.model, &into).await?;
        let storage = &self.maps.storage;
        let mut sessions = storage.stored_sessions(source.id).await?;
        let mut maps = vec![source.name.clone(), into.clone()];
        let copy = match copy {
            None => None,
            Some(row) => {
                maps.push(row.name.clone());
                let mut others = storage.stored_sessions(row.id).await?;
                others.retain(|other| sessions.iter().all(|session| session.number != other.number));
                sessions.extend(others);
                Some(Copy { events: storage.log_events(row.id).await?, row })
            }
        };
        let without_content = WithoutContent::SendWords {
            words_hash: model.words_hash.clone(),
            copy: copy.as_ref().map(|copy| copy.row.id),
        };
        let resending = Resending::new(source, sessions, into, without_content);
        let words = model.model.vocabulary().len();
        let repair = Repair { caller: caller.clone(), resending, copy, words };
        let rebuilding = self.clone();
        let work = |reporter: JobReporter| async move { rebuilding.repair(repair, &reporter).await };
        self.jobs.start(JobKind::RepairMap, &maps.iter().map(String::as_str).collect::<Vec<_>>(), work).await
    }

    async fn repair(&self, repair: Repair, reporter: &JobReporter) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        match self.send_what_is_left(&repair, reporter).await {
            Ok(losses) => {
                reporter.told(losses.in_words());
                self.done(&repair.resending.into, reporter).await
            }
            Err(stopped) => stopped.into(),
        }
    }

    async fn send_what_is_left(&self, repair: &Repair, reporter: &JobReporter) -> Result<Losses, Stopped> {
        let source = &repair.resending.source;
        let events = self.maps.storage.log_events(source.id).await.map_err(ServiceError::from)?;
        let pages =
            || (0..events).step_by(EVENTS_PAGE as usize).map(|from| from..(from + EVENTS_PAGE).min(events));
        let fraction = |positions: &Range<u64>| positions.start as f64 / events as f64;
        // Before anything is made: a wrong copy is noticed as a whole, and a map without damage.
        let mut damaged = self.maps.storage.damage(source.id).is_some();
        for positions in pages() {
            Stopped::unless(reporter.progress("looking for damage", fraction(&positions)))?;
            damaged |= self.left(repair, positions).await?.iter().any(|left| left.is_not_of(source.id));
        }
        if !damaged {
            return Err(Stopped::Failed(ServiceError::precondition(format_args!(
                "no damage was found in the map {}, so there is nothing to repair; `waypost-server check --deep` reads all \
                 that a data directory holds",
                source.name
            ))));
        }
        let kind = JobKind::RepairMap;
        self.make(kind, &repair.caller, source, &source.model, &repair.resending.into).await?;
        let (mut streams, mut losses) = (Streams::new(), Losses::default());
        for positions in pages() {
            Stopped::unless(reporter.progress("looking at the frames again", fraction(&positions)))?;
            self.check_unchanged(source).await?;
            let mut frames = Vec::new();
            for left in self.left(repair, positions.clone()).await? {
                match left {
                    Left::Event(map, MapEvent::Frame(event)) => {
                        // Its opening may be lost.
                        if !streams.contains_key(&event.session) {
                            self.send_noted(repair, &streams, &mut frames, &positions).await?;
                            self.open(&repair.resending, &mut streams, event.session).await?;
                        }
                        frames.push(KeptFrame { map, event: *event, note: String::new() });
                    }
                    Left::Event(_, MapEvent::SessionOpened { session }) => {
                        // In the order of the log, so that the new one is the same.
                        self.send_noted(repair, &streams, &mut frames, &positions).await?;
                        self.open(&repair.resending, &mut streams, session).await?;
                    }
                    Left::Event(_, MapEvent::Measured(_)) => losses.measured += 1,
                    Left::Event(_, MapEvent::Corrected(_)) => losses.corrected += 1,
                    Left::Nothing(what) => losses.events.push(what),
                }
            }
            self.send_noted(repair, &streams, &mut frames, &positions).await?;
        }
        losses.labels = self.carry_labels(repair).await?;
        losses.beside = repair.resending.lost();
        Ok(losses)
    }

    /// What there is of the events at `positions`, of the damaged map or of its copy.
    async fn left(&self, repair: &Repair, positions: Range<u64>) -> Result<Vec<Left>, ServiceError> {
        let Repair { resending: Resending { source, .. }, copy, words, caller: _ } = repair;
        let storage = &self.maps.storage;
        let salvaged = storage.salvage(source.id, positions.clone(), *words).await?;
        let Some(copy) = copy else {
            return Ok(salvaged.into_iter().map(|salvaged| Left::of(source.id, salvaged)).collect());
        };
        let Copy { row: copy, events } = copy;
        let there = positions.start.min(*events)..positions.end.min(*events);
        let mut copied = storage.salvage(copy.id, there, *words).await?.into_iter();
        let mut left = Vec::new();
        for (position, salvaged) in positions.zip(salvaged) {
            left.push(match (salvaged, copied.next()) {
                (Salvaged::Whole(event), Some(Salvaged::Whole(copied))) if event != copied => {
                    return Err(ServiceError::precondition(format_args!(
                        "the map {} is no earlier copy of {}: event {position} of its log is another, since it is another \
                         map, or sessions were removed from one of them; delete what was begun, and repair without it",
                        copy.name, source.name
                    )));
                }
                (Salvaged::Lost(_), Some(Salvaged::Whole(copied))) => Left::Event(copy.id, copied),
                (salvaged, _) => Left::of(source.id, salvaged),
            });
        }
        Ok(left)
    }

    /// Sends frames of the log at `positions`, with what their robots call them.
    async fn send_noted(
        &self,
        repair: &Repair,
        streams: &Streams,
        frames: &mut Vec<KeptFrame>,
        positions: &Range<u64>,
    ) -> Result<(), ServiceError> {
        let mut frames = std::mem::take(frames);
        self.add_notes(&repair.resending, &mut frames, positions).await?;
        self.send(&repair.resending, streams, frames).await
    }

    /// Gives frames what their robots call them, as far as that can be read.
    async fn add_notes(
        &self,
        resending: &Resending,
        frames: &mut [KeptFrame],
        positions: &Range<u64>,
    ) -> Result<(), ServiceError> {
        let storage = &self.maps.storage;
        // By map; none of one whose notes cannot be read at once.
        let mut known: HashMap<MapId, Option<HashMap<FrameId, String>>> = HashMap::new();
        for KeptFrame { map, event, note } in frames {
            if !known.contains_key(map) {
                let read = storage.notes(*map, positions.clone()).await;
                known.insert(*map, unless_damaged(read.map(by_position))?);
            }
            let found = match known.get_mut(map).and_then(Option::as_mut) {
                Some(notes) => Some(notes.remove(&event.frame).unwrap_or_default()),
                None => {
                    let read = storage.notes(*map, event.frame..event.frame + 1).await;
                    unless_damaged(read.map(by_position))?
                        .map(|mut notes| notes.remove(&event.frame).unwrap_or_default())
                }
            };
            match found {
                Some(found) => *note = found,
                None => resending.lose("what its robot calls it", event),
            }
        }
        Ok(())
    }

    /// Puts labels on the places where the frames of theirs are now; gives those that are lost.
    async fn carry_labels(&self, repair: &Repair) -> Result<Vec<String>, ServiceError> {
        let source = repair.resending.source.id;
        let storage = &self.maps.storage;
        let now = self.maps.open_maps.row(&repair.resending.into).await?;
        let Some(labels) = unless_damaged(storage.labels(source, PlaceId::new(0), u32::MAX).await)? else {
            return Ok(vec!["labels, which cannot be read".to_owned()]);
        };
        let mut lost = Vec::new();
        for LabelRow { place, label } in labels {
            match self.place_now(repair, &now, place).await? {
                Some(now_at) => storage.put_labels(now.id, &[now_at], &label).await?,
                None => lost.push(format!("label {label:?} of place {place}")),
            }
        }
        Ok(lost)
    }

    /// Where most of the frames of a place of the damaged map are in the new one.
    async fn place_now(
        &self,
        repair: &Repair,
        now: &MapRow,
        place: PlaceId,
    ) -> Result<Option<PlaceId>, ServiceError> {
        let Repair { resending: Resending { source, sessions, .. }, words, .. } = repair;
        let storage = &self.maps.storage;
        let witnesses = match storage.frames_of_place(source.id, place, END_OF_LOG, WITNESSES).await {
            Ok(positions) => storage.frames_at(source.id, &positions).await,
            Err(error) => Err(error),
        };
        let Some(witnesses) = unless_damaged(witnesses)? else { return Ok(None) };
        let mut votes: HashMap<PlaceId, u32> = HashMap::new();
        for witness in witnesses {
            let Some(session) = sessions.iter().find(|stored| stored.number == witness.session) else {
                continue;
            };
            let Some(number) = storage.session_number(now.id, &session.name).await? else { continue };
            let event = storage.event_of_sequence(now.id, number, witness.sequence, *words).await?;
            let decided = match event {
                Some(MapEvent::Frame(frame)) => frame.decision.place,
                Some(_) | None => None,
            };
            if let Some(decided) = decided {
                *votes.entry(decided).or_default() += 1;
            }
        }
        let most = votes.into_iter().max_by_key(|&(place, votes)| (votes, std::cmp::Reverse(place)));
        Ok(most.map(|(place, _)| place))
    }
}

/// What was read; none if it is damaged.
fn unless_damaged<T>(read: Result<T, StorageError>) -> Result<Option<T>, StorageError> {
    match read {
        Ok(read) => Ok(Some(read)),
        Err(StorageError::Rot(_)) => Ok(None),
        Err(error) => Err(error),
    }
}

/// An event that can be brought back, and the map that keeps what belongs to it; or what is lost.
enum Left {
    Event(MapId, MapEvent),
    Nothing(String),
}

impl Left {
    /// Whether the damaged map does not have it.
    fn is_not_of(&self, damaged: MapId) -> bool {
        match self {
            Self::Event(map, _) => *map != damaged,
            Self::Nothing(_) => true,
        }
    }

    fn of(map: MapId, salvaged: Salvaged) -> Self {
        match salvaged {
            Salvaged::Whole(event) => Self::Event(map, event),
            Salvaged::Lost(what) => Self::Nothing(what),
        }
    }
}

impl Losses {
    fn in_words(&self) -> String {
        let Self { events, measured, corrected, labels, beside } = self;
        let mut told = Vec::new();
        let lost: Vec<&str> = [events, beside, labels].into_iter().flatten().map(String::as_str).collect();
        if !lost.is_empty() {
            let named = lost.iter().take(MOST_TOLD).copied().collect::<Vec<_>>().join("; ");
            told.push(match lost.len().saturating_sub(MOST_TOLD) {
                0 => format!("lost: {named}"),
                more => format!("lost: {named}; and {more} more"),
            });
        }
        if measured + corrected > 0 {
            told.push(format!(
                "to be said again: {measured} poses that robots measured, {corrected} corrections of people"
            ));
        }
        if told.is_empty() { "nothing is lost".to_owned() } else { told.join("; ") }
    }
}
