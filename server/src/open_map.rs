// long: the one thread of a map, from its queue through the decision to the commit and the answer.
//! The one writer of a map: a thread that decides, applies, commits in groups, and only then answers.

pub(crate) mod answers;
pub(crate) mod appearance;
mod checkpoints;
mod correcting;
mod handle;
mod leading;
mod localizers;
mod measuring;
mod open_maps;
mod reads;
mod recent;
mod requests;
mod tracking;
mod views;

pub(crate) use self::answers::PlaceGraph;
pub(crate) use self::handle::{MapHandle, WriterGone};
pub(crate) use self::open_maps::{OpenMaps, no_such_map};
pub(crate) use self::recent::Recent;
pub(crate) use self::requests::{
    CorrectionRequest, FrameFailure, FrameRequest, FrameSource, FrameWork, LookRequest, Looked,
    MeasuredFrames, Opener, PlaceBounds, PlacesWanted, PlanFrom, SessionMode, SessionOpening, StreamOpening,
    Verdict,
};
pub(crate) use self::views::{FrameStore, SeenFeatures, compare, compared, stored_features, verifier};

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::ingest::{FeatureRecord, Tracker, Verifier};
use fabmap::recognizer::{Stage, StageObserver};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use topomap::evidence::{Candidate, Match};
use topomap::ids::{FrameId, SessionId};
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{EarlierFrame, FrameInput, MapPose, Mapper};

use self::answers::{FrameAnswer, GeometryView, MatchView, reference};
use self::checkpoints::Checkpoints;
use self::handle::Usage;
use self::localizers::Localizers;
use self::recent::RecentFrame;
use self::requests::{FrameReply, MapRequest, OpenedSession};
use crate::camera::Camera;
use crate::clock::now_ns;
use crate::error::{ArchiveError, ServiceError};
use crate::ingest::intrinsics::Intrinsics;
use crate::ingest::model::LoadedModel;
use crate::ingest::panoramic::PanoramicOptics;
use crate::metrics::{FrameTimings, Metrics};
use crate::quotas::Reserved;
use crate::storage::{LogEntry, MapRow, Medium, MediumKind, SessionRow, Storage, StorageError};

/// Most frames that share one commit.
const MAX_BATCH: usize = 64;

/// Frames of a map that are kept in memory, of a kilobyte or two each.
const MOST_RECENT: usize = 4096;

/// Frames whose features are, of about 80 kB each; more than a batch, so that none of it is missed.
const MOST_RECENT_FEATURES: usize = 256;

/// A map that is asked nothing for so long forgets what is on the disk, too.
const QUIET: Duration = Duration::from_secs(30);

/// The state of an open map and its way to the disk.
struct MapWriter {
    map: MapRow,
    model: Arc<LoadedModel>,
    mapper: Mapper,
    storage: Storage,
    metrics: Metrics,
    runtime: Handle,
    sessions: Vec<SessionRow>,
    /// Of the sessions' cameras, where geometry can use them.
    intrinsics: HashMap<SessionId, Intrinsics>,
    /// The same of cameras that see all around.
    around: HashMap<SessionId, PanoramicOptics>,
    /// The latest stream of each session, and how to tell it that a later one took over: frames of an
    /// older one are refused.
    streams: HashMap<SessionId, (u64, CancellationToken)>,
    /// Robots that only look.
    localizers: Localizers,
    /// Decided and applied, but not yet on the disk.
    pending: Vec<Pending>,
    /// What earlier frames showed, as far as it was asked for lately.
    recent: RefCell<Recent<RecentFrame>>,
    /// Where their words are; `None` if that is not kept.
    recent_features: RefCell<Recent<Option<SeenFeatures>>>,
    /// Of the sessions that sent frames lately.
    trackers: Recent<Tracker, SessionId>,
    verifier: Verifier,
    checkpoints: Checkpoints,
    usage: Arc<Usage>,
}

/// A frame on its way to the disk, and who waits for it.
struct Pending {
    entry: LogEntry,
    reply: FrameReply,
    timings: FrameTimings,
    /// Where the robot is, as the map was after its frame.
    map_pose: Option<MapPose>,
    since: Instant,
    /// Held until what the frame keeps is counted.
    room: Option<Box<Reserved>>,
}

/// Whether a writer goes on.
enum Serving {
    On,
    Ended,
}

/// The map in memory is ahead of the disk, or the disk cannot be read: the map must be dropped and
/// opened anew. Frames that are not answered by then are refused for now; these hear why.
#[derive(Default)]
struct CommitFailed {
    refused: Vec<(FrameReply, ServiceError)>,
}

impl MapWriter {
    /// Serves requests until the map is closed or a commit fails.
    fn run(mut self, mut requests: mpsc::Receiver<MapRequest>) {
        while let Some(first) = self.next(&mut requests) {
            let mut batch = vec![first];
            while batch.len() < MAX_BATCH
                && let Ok(next) = requests.try_recv()
            {
                batch.push(next);
            }
            match self.serve(batch) {
                Ok(Serving::On) => {}
                Ok(Serving::Ended) => break,
                Err(CommitFailed { refused }) => {
                    let map = &self.map.name;
                    tracing::warn!(map, "the map is dropped from memory and will be opened from the disk");
                    // Closed first: who hears of the refusal and asks again must find a new writer.
                    drop(requests);
                    for (reply, error) in refused {
                        let _ = reply.send(Err(FrameFailure::Refused(error)));
                    }
                    // The next opening of the map waits for this thread: the disk must be at rest by then.
                    self.finish_checkpoint();
                    return;
                }
            }
            self.checkpoint_if_due();
        }
        self.checkpoint_now();
    }

    /// The next request; `None` once nobody can ask any more. What is on the disk, too, is forgotten where none comes for a while.
    fn next(&mut self, requests: &mut mpsc::Receiver<MapRequest>) -> Option<MapRequest> {
        let soon = self.runtime.block_on(async { tokio::time::timeout(QUIET, requests.recv()).await });
        soon.unwrap_or_else(|_quiet| {
            self.recent.get_mut().forget();
            self.recent_features.get_mut().forget();
            self.trackers.forget();
            requests.blocking_recv()
        })
    }

    fn serve(&mut self, batch: Vec<MapRequest>) -> Result<Serving, CommitFailed> {
        let mut serving = Serving::On;
        // Reads see what is on the disk: they wait for the commit of the frames beside them, and so cost
        // these no commit of their own.
        let mut reads = Vec::new();
        for request in batch {
            match request {
                MapRequest::Frame(session, request) => self.decide(session, request)?,
                MapRequest::OpenSession { opening, reply } => {
                    self.commit()?;
                    let opened = self.open(opening);
                    let failed =
                        matches!(opened, Err(ServiceError::Internal | ServiceError::Unavailable { .. }));
                    let _ = reply.send(opened);
                    // Whether the row is on the disk is not known; a fresh look is.
                    if failed {
                        return Err(CommitFailed::default());
                    }
                }
                MapRequest::Measure { frames, reply } => {
                    self.commit()?;
                    let _ = reply.send(self.measure(&frames)?);
                }
                MapRequest::Correct { request, reply } => {
                    self.commit()?;
                    let _ = reply.send(self.correct(&request)?);
                }
                MapRequest::Read(read) => reads.push(read),
                MapRequest::Close => {
                    serving = Serving::Ended;
                    break;
                }
                MapRequest::CloseUnused(reply) => {
                    let unused = !self.localizers.any_open();
                    let _ = reply.send(unused);
                    if unused {
                        serving = Serving::Ended;
                        break;
                    }
                }
            }
        }
        self.commit()?;
        reads.into_iter().for_each(|read| self.read(read));
        Ok(serving)
    }

    /// Decides a frame and applies it; the answer waits for the commit.
    fn decide(&mut self, session: SessionId, request: FrameRequest) -> Result<(), CommitFailed> {
        let FrameRequest { stream, work, reply, since } = request;
        if self.streams.get(&session).is_some_and(|&(latest, _)| latest > stream) {
            let _ = reply.send(Err(FrameFailure::Ended(ServiceError::taken_over())));
            return Ok(());
        }
        let last = self.mapper.map().session(session).and_then(|session| session.last_sequence);
        if last.is_some_and(|last| work.sequence() <= last) {
            return self.answer_resend(session, work.sequence(), reply);
        }
        let FrameWork::Fresh { input, features, media, note, mut timings, room } = work else {
            let _ = reply.send(Err(not_stored()));
            return Ok(());
        };
        if let Err(damaged) = self.storage.check_sound(self.map.id) {
            let _ = reply.send(Err(FrameFailure::Ended(damaged.into())));
            return Ok(());
        }
        self.load_tracker(session)?;
        let mut clock = StageClock::start(&mut timings);
        match self.decide_and_apply(*input, features, media, &mut clock) {
            Ok(entry) => {
                let entry = LogEntry { note, ..entry };
                let session = self.mapper.map().session(session).filter(|_| has_odometry(&entry.event));
                let map_pose = session.and_then(|session| self.mapper.map_pose(session));
                self.pending.push(Pending { entry, reply, timings, map_pose, since, room });
            }
            Err(error) => {
                // Frames behind it in the queue must not be committed before it comes again.
                if matches!(error, ServiceError::Unavailable { .. }) {
                    return Err(CommitFailed { refused: vec![(reply, error)] });
                }
                let _ = reply.send(Err(FrameFailure::Refused(error)));
            }
        }
        Ok(())
    }

    fn decide_and_apply(
        &mut self,
        input: FrameInput,
        features: Option<Arc<FeatureRecord>>,
        mut media: Vec<Medium>,
        clock: &mut StageClock<'_>,
    ) -> Result<LogEntry, ServiceError> {
        let session = input.session;
        let (features, tracker) = features
            .map(|features| self.tracked(session, features, input.odometry.as_ref(), &mut media))
            .unzip();
        clock.tracked();
        let intrinsics = self.intrinsics.get(&input.session);
        let around = self.around.get(&input.session).cloned();
        let features = features.map(|features| SeenFeatures::new(features, intrinsics).all_around(around));
        let recognized = self.mapper.recognize(input, clock)?;
        let (proposed, comparisons) = compared(recognized, self, features.as_ref(), &self.verifier)?;
        if self.mapper.verifies() {
            clock.completed(Stage::Verification);
        }
        let event = proposed.decide(&comparisons)?.event;
        let position = event.frame;
        let event = MapEvent::Frame(Box::new(event));
        self.mapper.apply(&event).map_err(ServiceError::internal)?;
        self.checkpoints.changes().follow(&event);
        // As the disk will have it: what a frame is compared with must not depend on what is in memory.
        let kept = media.iter().any(|medium| medium.kind == MediumKind::Features);
        self.recent_features.get_mut().keep(position, features.filter(|_| kept));
        if let Some(tracker) = tracker.flatten() {
            self.trackers.keep(session, tracker);
        }
        Ok(LogEntry { position, event, media, note: String::new() })
    }

    /// Brings all pending frames to the disk in one transaction, then answers them.
    fn commit(&mut self) -> Result<(), CommitFailed> {
        if self.pending.is_empty() {
            return Ok(());
        }
        let pending = std::mem::take(&mut self.pending);
        let (entries, waiting): (Vec<LogEntry>, Vec<_>) = pending
            .into_iter()
            .map(|Pending { entry, reply, timings, map_pose, since, room }| {
                (entry, (reply, timings, map_pose, since, room))
            })
            .unzip();
        let entries: Arc<[LogEntry]> = entries.into();
        if let Err(error) = self.runtime.block_on(self.storage.append(self.map.id, entries.clone())) {
            tracing::error!(map = self.map.name, %error, "commit failed");
            let error = match ServiceError::from(error) {
                ServiceError::Internal => {
                    ServiceError::unavailable("the frame could not be stored; send it again")
                }
                other => other,
            };
            let refused = waiting.into_iter().map(|(reply, ..)| (reply, error.clone())).collect();
            return Err(CommitFailed { refused });
        }
        self.metrics.committed(entries.len());
        tracing::debug!(map = self.map.name, frames_committed = entries.len(), "committed");
        for (entry, (reply, mut timings, map_pose, since, _room)) in entries.iter().zip(waiting) {
            timings.total = since.elapsed();
            timings.commit = timings.total.saturating_sub(timings.work());
            if let MapEvent::Frame(event) = &entry.event {
                self.recent.get_mut().keep(event.frame, RecentFrame::of(event, entry.note.clone()));
                let answer = self.answer(event, Some(timings));
                let answer = answer.map(|answer| FrameAnswer { map_pose, ..answer });
                let _ = reply.send(answer.map_err(|_| answer_unreadable()));
            }
        }
        Ok(())
    }

    fn answer_resend(
        &mut self,
        session: SessionId,
        sequence: u64,
        reply: FrameReply,
    ) -> Result<(), CommitFailed> {
        // The first copy may still be on its way to the disk; an answer must wait for it.
        self.commit()?;
        let words = self.model.model.vocabulary().len();
        let stored = self.storage.event_of_sequence(self.map.id, session, sequence, words);
        let answer = match self.runtime.block_on(stored) {
            Ok(Some(MapEvent::Frame(event))) => self.answer(&event, None).map_err(|_| answer_unreadable()),
            Ok(
                Some(MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_)) | None,
            ) => Err(FrameFailure::Refused(self.never_sent(session, sequence))),
            Err(error @ (StorageError::Damaged(_) | StorageError::Rot(_))) => {
                Err(FrameFailure::Refused(error.into()))
            }
            Err(error) => {
                tracing::error!(map = self.map.name, %error, "a stored answer could not be read");
                Err(answer_unreadable())
            }
        };
        let _ = reply.send(answer);
        Ok(())
    }

    fn never_sent(&self, session: SessionId, sequence: u64) -> ServiceError {
        let last = self.mapper.map().session(session).and_then(|session| session.last_sequence).unwrap_or(0);
        ServiceError::precondition(format_args!(
            "sequence number {sequence} was skipped and {last} is committed already; number frames upwards from there"
        ))
    }

    fn answer(&self, event: &FrameEvent, timings: Option<FrameTimings>) -> Result<FrameAnswer, ServiceError> {
        let session = self.mapper.map().session(event.session);
        Ok(FrameAnswer::new(
            event,
            session.and_then(|session| session.last_sequence).unwrap_or(event.sequence),
            event.decision.closure.map(|found| self.matched(found, &event.candidates)).transpose()?,
            event.proposal.map(|found| self.matched(found, &event.candidates)).transpose()?,
            timings,
        ))
    }

    /// A match with its frame as users name it.
    fn matched(&self, found: Match, candidates: &[Candidate]) -> Result<MatchView, ServiceError> {
        let recent = self.recent.borrow().get(found.frame).map(|recent| recent.stored.clone());
        let stored = match recent {
            Some(stored) => Some(stored),
            None => self.runtime.block_on(self.storage.frames_at(self.map.id, &[found.frame]))?.pop(),
        };
        let Some(stored) = stored else {
            return Err(self.runtime.block_on(self.storage.event_is_gone(self.map.id, found.frame)).into());
        };
        let frame = reference(&self.map.name, &self.sessions, &stored);
        let Match { place, posterior, log_odds, frame: _ } = found;
        Ok(MatchView { place, posterior, log_odds, frame, geometry: GeometryView::of(found, candidates) })
    }

    fn open(&mut self, opening: SessionOpening) -> Result<OpenedSession, ServiceError> {
        let SessionOpening { name, mode, camera, stream } = opening;
        let name = name.unwrap_or_else(|| self.unused_session_name());
        match mode {
            SessionMode::Map => {
                let opened = self.open_session(name, camera.as_ref(), &stream.opener)?;
                if let FrameSource::Session(session) = opened.source {
                    self.follow(session, stream.stream, stream.taken_over);
                }
                Ok(opened)
            }
            SessionMode::Localize => {
                self.open_localizer(name, camera.as_ref().and_then(Intrinsics::of_camera), stream)
            }
        }
    }

    fn open_session(
        &mut self,
        name: String,
        camera: Option<&Camera>,
        opener: &Opener,
    ) -> Result<OpenedSession, ServiceError> {
        if let Some(session) = self.sessions.iter().find(|session| session.name == name) {
            // What is stored of a damaged map is still answered to those who send it again.
            opener.check(&name, session.owner.as_deref())?;
            let number = session.number;
            let last_committed = self.mapper.map().session(number).and_then(|session| session.last_sequence);
            let owner = session.owner.clone();
            return Ok(OpenedSession { source: FrameSource::Session(number), name, owner, last_committed });
        }
        self.storage.check_sound(self.map.id)?;
        if !self.localizers.free(&name) {
            return Err(ServiceError::precondition(format_args!(
                "a robot is localizing under the name {name}; choose another name for the session"
            )));
        }
        let (number, owner) = (self.mapper.map().next_session(), opener.token.clone());
        let session = SessionRow { number, name: name.clone(), owner: owner.clone() };
        let position = self.mapper.map().events();
        let opened = self.storage.open_session(self.map.id, position, &session, camera, now_ns());
        self.runtime.block_on(opened)?;
        let number = session.number;
        let event = MapEvent::SessionOpened { session: number };
        self.mapper.apply(&event).map_err(ServiceError::internal)?;
        self.checkpoints.changes().follow(&event);
        self.sessions.push(session);
        self.intrinsics.extend(camera.and_then(Intrinsics::of_camera).map(|known| (number, known)));
        self.around.extend(camera.and_then(PanoramicOptics::of_camera).map(|known| (number, known)));
        Ok(OpenedSession { source: FrameSource::Session(number), name, owner, last_committed: None })
    }

    fn unused_session_name(&self) -> String {
        let taken = |name: &String| {
            self.localizers.is_taken(name) || self.sessions.iter().any(|session| session.name == *name)
        };
        let mut number = self.sessions.len();
        loop {
            let name = format!("session-{number}");
            if !taken(&name) {
                return name;
            }
            number += 1;
        }
    }

    /// From now on frames of `stream` are taken for a session; an earlier stream is told so.
    fn follow(&mut self, session: SessionId, stream: u64, taken_over: CancellationToken) {
        let later = self.streams.get(&session).is_some_and(|&(latest, _)| latest > stream);
        if later {
            taken_over.cancel();
        } else if let Some((_, before)) = self.streams.insert(session, (stream, taken_over)) {
            before.cancel();
        }
    }
}

fn has_odometry(event: &MapEvent) -> bool {
    match event {
        MapEvent::Frame(frame) => frame.odometry.is_some(),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => false,
    }
}

/// A robot that took a frame for stored may send it again.
fn not_stored() -> FrameFailure {
    FrameFailure::Refused(ServiceError::unavailable("the frame was not stored; send it again"))
}

/// The frame is durable: whatever failed after that, sending it again gets the answer.
fn answer_unreadable() -> FrameFailure {
    let message = "the frame is stored, but its answer could not be read; send it again";
    FrameFailure::Refused(ServiceError::unavailable(message))
}

impl MapWriter {
    /// An earlier frame, from those on their way to the disk or from the disk.
    fn read_frame(&self, frame: FrameId) -> Result<Option<EarlierFrame>, ArchiveError> {
        let Self { pending, recent, storage, map, model, runtime, .. } = self;
        if let Some(recent) = recent.borrow().get(frame) {
            return Ok(Some(EarlierFrame { observation: recent.observation.clone(), at: recent.at }));
        }
        let of_event =
            |event: &FrameEvent| EarlierFrame { observation: event.observation.clone(), at: event.at };
        if let Some(pending) = pending.iter().find(|pending| pending.entry.position == frame)
            && let MapEvent::Frame(event) = &pending.entry.event
        {
            return Ok(Some(of_event(event)));
        }
        match runtime.block_on(storage.noted_event_at(map.id, frame, model.model.vocabulary().len())) {
            Ok((MapEvent::Frame(event), note)) => {
                recent.borrow_mut().keep(frame, RecentFrame::of(&event, note));
                Ok(Some(of_event(&event)))
            }
            Ok((MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_), _))
            | Err(StorageError::Damaged(_)) => {
                tracing::error!(
                    map = map.name,
                    frame,
                    "a frame of the log cannot be read; it is no longer matched"
                );
                Ok(None)
            }
            Err(error) => Err(ArchiveError::of(frame, error)),
        }
    }
}

/// Measures the stages of a decision.
struct StageClock<'a> {
    last: Instant,
    timings: &'a mut FrameTimings,
}

impl<'a> StageClock<'a> {
    fn start(timings: &'a mut FrameTimings) -> Self {
        Self { last: Instant::now(), timings }
    }

    /// The features have their depths: geometry, as the comparisons are.
    fn tracked(&mut self) {
        let elapsed = self.since_the_last();
        self.timings.verification += elapsed;
    }

    fn since_the_last(&mut self) -> Duration {
        let now = Instant::now();
        now - std::mem::replace(&mut self.last, now)
    }
}

impl StageObserver for StageClock<'_> {
    fn completed(&mut self, stage: Stage) {
        let elapsed = self.since_the_last();
        match stage {
            Stage::Likelihood => self.timings.likelihood = elapsed,
            Stage::NewPlace => self.timings.new_place = elapsed,
            Stage::Filter => self.timings.filter = elapsed,
            Stage::Verification => self.timings.verification += elapsed,
        }
    }
}
