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

/// What is lost that is told by name.
const MOST_TOLD: usize = 20;

/// A damaged map, and what its frames are.
struct Repair {
    /// Whose the new map is.
    caller: Caller,
    resending: Resending,
    /// The map as it was earlier.
    copy: Option<MapRow>,
    /// Of the model that both have.
    words: usize,
}

/// What could not be brought back.
#[derive(Debug, Default)]
struct Losses {
    events: Vec<String>,
    /// What robots measured, and people corrected: said of frames of the damaged map.
    measured: u64,
    corrected: u64,
    labels: Vec<LabelRow>,
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
        self.was_begun(&source, &source.model, &into).await?;
        let sessions = self.maps.storage.stored_sessions(source.id).await?;
        let maps: Vec<String> = [source.name.clone(), into.clone()]
            .into_iter()
            .chain(copy.as_ref().map(|copy| copy.name.clone()))
            .collect();
        let without_content = WithoutContent::SendWords(model.words_hash.clone());
        let resending = Resending { source, sessions, into, without_content };
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
        self.make(&repair.caller, source, &source.model, &repair.resending.into).await?;
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
        let copied = storage.salvage(copy.id, positions.clone(), *words).await?;
        let mut left = Vec::new();
        for ((position, salvaged), copied) in positions.zip(salvaged).zip(copied) {
            left.push(match (salvaged, copied) {
                (Salvaged::Whole(event), Salvaged::Whole(copied)) if event != copied => {
                    return Err(ServiceError::precondition(format_args!(
                        "the map {} is no earlier copy of {}: event {position} of its log is another, since it is another \
                         map, or sessions were removed from one of them; delete what was begun, and repair without it",
                        copy.name, source.name
                    )));
                }
                (Salvaged::Lost(_), Salvaged::Whole(copied)) => Left::Event(copy.id, copied),
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
        self.add_notes(&mut frames, positions).await;
        self.send(&repair.resending, streams, frames).await
    }

    /// Gives frames what their robots call them; of what is damaged, nothing.
    async fn add_notes(&self, frames: &mut [KeptFrame], positions: &Range<u64>) {
        let mut notes: HashMap<MapId, HashMap<FrameId, String>> = HashMap::new();
        for KeptFrame { map, event, note } in frames {
            if !notes.contains_key(map) {
                let read = self.maps.storage.notes(*map, positions.clone()).await;
                notes.insert(*map, by_position(read.unwrap_or_default()));
            }
            if let Some(found) = notes.get_mut(map).and_then(|notes| notes.remove(&event.frame)) {
                *note = found;
            }
        }
    }

    /// Puts labels on the places where the frames of theirs are now; gives those that found none.
    async fn carry_labels(&self, repair: &Repair) -> Result<Vec<LabelRow>, ServiceError> {
        let source = repair.resending.source.id;
        let storage = &self.maps.storage;
        let now = self.maps.open_maps.row(&repair.resending.into).await?;
        let labels = match storage.labels(source, PlaceId::new(0), u32::MAX).await {
            Err(StorageError::Rot(_)) => Vec::new(),
            labels => labels?,
        };
        let mut lost = Vec::new();
        for label in labels {
            match self.place_now(repair, &now, label.place).await? {
                Some(place) => storage.put_labels(now.id, &[place], &label.label).await?,
                None => lost.push(label),
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
        let witnesses = match storage.frames_of_place(source.id, place, FrameId::MAX >> 1, WITNESSES).await {
            Ok(positions) => storage.frames_at(source.id, &positions).await,
            Err(error) => Err(error),
        };
        let witnesses = match witnesses {
            Err(StorageError::Rot(_)) => return Ok(None),
            witnesses => witnesses?,
        };
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
        let Self { events, measured, corrected, labels } = self;
        let mut told = Vec::new();
        if !events.is_empty() {
            let more = events.len().saturating_sub(MOST_TOLD);
            let named = events.iter().take(MOST_TOLD).cloned().collect::<Vec<_>>().join("; ");
            told.push(match more {
                0 => format!("lost: {named}"),
                more => format!("lost: {named}; and {more} more"),
            });
        }
        let labels =
            labels.iter().map(|LabelRow { place, label }| format!("lost: label {label:?} of place {place}"));
        told.extend(labels);
        if measured + corrected > 0 {
            told.push(format!(
                "to be said again: {measured} poses that robots measured, {corrected} corrections of people"
            ));
        }
        if told.is_empty() { "nothing is lost".to_owned() } else { told.join("; ") }
    }
}
