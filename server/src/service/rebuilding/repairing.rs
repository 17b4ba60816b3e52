//! A damaged map made anew, from what is left of it and from an earlier copy.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use fabmap::appearance::PlaceId;
use topomap::ids::FrameId;
use topomap::log::{Confirmation, Correction, CorrectionEvent, MapEvent, Undoing};
use topomap::mapper::Said;

use super::left::{Left, is_said_again, unless_damaged};
use super::losses::Losses;
use super::resending::{KeptFrame, Resending, Streams, WithoutContent};
use super::{EVENTS_PAGE, Rebuilding, by_position};
use crate::error::ServiceError;
use crate::names::{check_id, map_in};
use crate::open_map::{CorrectionRequest, Verdict};
use crate::service::jobs::{Begun, JobOutcome, JobReporter, JobRequest, JobStatus, Stopped, Task};
use crate::service::tokens::Caller;
use crate::storage::{JobKind, LabelRow, MapId, MapRow, Salvaged};

/// Frames of a place that are asked where it is now.
const WITNESSES: u32 = 16;

/// Above every position of a log.
const END_OF_LOG: FrameId = i64::MAX as FrameId;

/// A damaged map, and what its frames are.
struct Repair {
    /// Whose the new map is.
    caller: Caller,
    resending: Arc<Resending>,
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

impl Rebuilding {
    /// Begins to repair a map into a new one. If that was begun before and cut off, it goes on where it was.
    pub(crate) async fn start_repair(
        &self,
        caller: &Caller,
        name: &str,
        into: &str,
        copy: &str,
    ) -> Result<JobStatus, ServiceError> {
        self.start_repairing(caller, name, into, copy, Begun::Now).await
    }

    pub(in crate::service) async fn start_repairing(
        &self,
        caller: &Caller,
        name: &str,
        into: &str,
        copy: &str,
        begun: Begun,
    ) -> Result<JobStatus, ServiceError> {
        let task = Task::RepairMap {
            map: name.to_owned(),
            into: into.to_owned(),
            copy: copy.to_owned(),
            asked_by: caller.token.clone(),
        };
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
        let resending = Arc::new(Resending::new(source, sessions, into, without_content));
        let words = model.model.vocabulary().len();
        let repair = Repair { caller: caller.clone(), resending, copy, words };
        let rebuilding = self.clone();
        let work = move |reporter: JobReporter| async move { rebuilding.repair(repair, &reporter).await };
        let request = JobRequest { kind: JobKind::RepairMap, maps, task: Some(task), begun };
        self.jobs.start(request, work).await
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
            let left = self.left(repair, positions.clone()).await?;
            damaged |= left.iter().any(|left| left.is_not_of(source.id));
            if !damaged {
                damaged = !self.is_whole_beside(source.id, positions).await?;
            }
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
        // Corrections of the new map, by their positions in the log of the other.
        let mut said = HashMap::new();
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
                    Left::Event(_, MapEvent::Corrected(event)) => {
                        // What was decided afterwards rests on it.
                        self.send_noted(repair, &streams, &mut frames, &positions).await?;
                        losses.corrections.extend(self.say_again(repair, &mut said, &event).await?);
                    }
                    Left::Nothing(what) => losses.events.push(what),
                }
            }
            self.send_noted(repair, &streams, &mut frames, &positions).await?;
        }
        losses.labels = self.carry_labels(repair).await?;
        losses.beside = repair.resending.lost();
        Ok(losses)
    }

    /// Whether all can be read that a map keeps of frames beside its log. Nobody may have met that damage yet.
    async fn is_whole_beside(&self, map: MapId, positions: Range<u64>) -> Result<bool, ServiceError> {
        let storage = &self.maps.storage;
        if unless_damaged(storage.notes(map, positions.clone()).await)?.is_none() {
            return Ok(false);
        }
        for frame in positions {
            if unless_damaged(storage.read_media(map, frame).await)?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// What there is of the events at `positions`, of the damaged map or of its copy.
    async fn left(&self, repair: &Repair, positions: Range<u64>) -> Result<Vec<Left>, ServiceError> {
        let Repair { resending, copy, words, caller: _ } = repair;
        let source = &resending.source;
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

    /// Says a correction again of the same frames of the new map, as who said it and when; what is lost where that makes no
    /// sense there. One that is there already, since a repair that was begun has said it, stays.
    async fn say_again(
        &self,
        repair: &Repair,
        said: &mut HashMap<u64, u64>,
        event: &CorrectionEvent,
    ) -> Result<Option<String>, ServiceError> {
        let CorrectionEvent { position, session: _, by, said_ns, correction } = event;
        let now = self.maps.open_maps.row(&repair.resending.into).await?;
        let there = self.maps.storage.corrections(now.id).await?;
        if let Some(there) = there.iter().find(|there| is_said_again(event, there)) {
            said.insert(*position, there.position);
            return Ok(None);
        }
        let lost = |why: &dyn std::fmt::Display| {
            let what = match correction {
                Correction::Withdrawn(_) => "a loop closure withdrawn",
                Correction::Confirmed(_) => "a loop closure confirmed",
                Correction::Undone(_) => "a correction undone",
            };
            Ok(Some(format!("event {position} of the log, {what} by {by:?}: {why}")))
        };
        let verdict = match correction {
            Correction::Withdrawn(withdrawal) => {
                let frame = self.position_now(repair, &now, withdrawal.frame).await?;
                frame.map(|frame| Verdict::Withdrawn { frame })
            }
            Correction::Confirmed(Confirmation { frame, earlier, link: _ }) => {
                let frame = self.position_now(repair, &now, *frame).await?;
                let matched = self.position_now(repair, &now, *earlier).await?;
                frame.zip(matched).map(|(frame, matched)| Verdict::Confirmed { frame, matched })
            }
            Correction::Undone(Undoing { correction, place: _ }) => {
                said.get(correction).map(|&correction| Verdict::Undone { correction })
            }
        };
        let Some(verdict) = verdict else { return lost(&"what it is about is lost") };
        let open = self.maps.open_maps.open_of(&now).await?;
        let request = CorrectionRequest { verdict, said: Said { by: by.clone(), said_ns: *said_ns } };
        match open.correct(request).await {
            Ok(again) => {
                said.insert(*position, again.position);
                Ok(None)
            }
            Err(
                error @ (ServiceError::FailedPrecondition { .. }
                | ServiceError::NotFound { .. }
                | ServiceError::InvalidArgument { .. }),
            ) => lost(&error),
            Err(error) => Err(error),
        }
    }

    /// Where a frame of the damaged map is in the log of the new one, if it could be brought back.
    async fn position_now(
        &self,
        repair: &Repair,
        now: &MapRow,
        frame: FrameId,
    ) -> Result<Option<FrameId>, ServiceError> {
        let left = self.left(repair, frame..frame + 1).await?.pop();
        let Some(Left::Event(_, MapEvent::Frame(event))) = left else { return Ok(None) };
        let session = repair.resending.sessions.iter().find(|stored| stored.number == event.session);
        let Some(session) = session else { return Ok(None) };
        let storage = &self.maps.storage;
        let Some(number) = storage.session_number(now.id, &session.name).await? else { return Ok(None) };
        Ok(storage.position_of_sequence(now.id, number, event.sequence).await?)
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
        let Repair { resending, words, .. } = repair;
        let Resending { source, sessions, .. } = &**resending;
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
