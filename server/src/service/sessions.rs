//! Sessions: a robot's stream of frames into a map.

mod order;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use fabmap::appearance::PlaceId;
use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio_util::sync::CancellationToken;
use topomap::event::{FrameEvent, Match, Reason};
use topomap::mapper::{FrameInput, Localizer, MapPose};
use topomap::odometry::Odometry;
use topomap::verification::{Candidate, Motion, Similarity, TwoView};

use self::order::Order;
use super::Service;
use super::camera::PanoramicOptics;
use super::content::{Content, Words};
use super::map_settings::{self, Keep, MapSettings, NavigationStrategy};
pub(crate) use super::map_writer::SessionMode;
use super::map_writer::{
    FrameFailure, FrameRequest, FrameSource, FrameWork, MapHandle, SessionOpening, StreamOpening, WriterGone,
};
use super::maps::FrameReference;
use super::names::{check_id, map_in, session_name};
use crate::error::ServiceError;
use crate::extraction::{LoadedModel, Observed};
use crate::storage::MapEdition;

/// How often a stream whose map was dropped from memory looks whether it still exists.
const REOPENED_POLL: Duration = Duration::from_millis(500);

/// Most places that an answer lists.
pub(super) const ANSWERED_PLACES: usize = 10;

/// Streams that may be open at a time: each holds a few frames, of up to 4 MiB each.
pub(super) const MAX_STREAMS: usize = 500;

/// When to ask again for a stream.
const STREAM_RETRY: Duration = Duration::from_secs(5);

/// A frame as a robot sends it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    pub(crate) content: Content,
    pub(crate) odometry: Option<Odometry>,
}

/// The answer to a frame that is durable.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameAnswer {
    pub(crate) sequence: u64,
    pub(crate) last_committed: u64,
    pub(crate) reason: Reason,
    pub(crate) place: Option<PlaceId>,
    pub(crate) posterior: f64,
    pub(crate) new_place_posterior: f64,
    /// The most probable places, most probable first.
    pub(crate) places: Vec<(PlaceId, f64)>,
    pub(crate) closure: Option<MatchView>,
    pub(crate) proposal: Option<MatchView>,
    pub(crate) words: u64,
    /// `None` if the answer comes from the store.
    pub(crate) timings: Option<FrameTimings>,
    /// Where the robot is on the map, if that is known; `None` if the answer comes from the store.
    pub(crate) map_pose: Option<MapPose>,
}

/// An earlier frame of a place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatchView {
    pub(crate) place: PlaceId,
    pub(crate) posterior: f64,
    pub(crate) log_odds: f64,
    pub(crate) frame: FrameReference,
    /// `None` where geometry was not asked.
    pub(crate) geometry: Option<GeometryView>,
}

/// What geometry found between a frame and one that it matched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GeometryView {
    pub(crate) matches: u32,
    pub(crate) inliers: u32,
    /// In inliers, with what the frames before say.
    pub(crate) evidence: f64,
    /// That both show the same place, by words and geometry together.
    pub(crate) probability: f64,
    pub(crate) similarity: Option<Similarity>,
}

impl GeometryView {
    /// What was found for `matched`, if it is among the candidates.
    pub(super) fn of(matched: Match, candidates: &[Candidate]) -> Option<Self> {
        let candidate = candidates.iter().find(|candidate| candidate.matched.frame == matched.frame)?;
        let TwoView { matches, inliers, motion, .. } = candidate.view?;
        let similarity = match motion {
            Some(Motion::Similarity(similarity)) => Some(similarity),
            Some(Motion::Essential { .. } | Motion::Fundamental(_)) | None => None,
        };
        let (evidence, probability) = (candidate.evidence(), candidate.probability());
        Some(Self { matches, inliers, evidence, probability, similarity })
    }
}

/// Where a frame's time went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FrameTimings {
    pub(crate) extract: Duration,
    pub(crate) quantize: Duration,
    pub(crate) likelihood: Duration,
    pub(crate) new_place: Duration,
    pub(crate) filter: Duration,
    pub(crate) verification: Duration,
    pub(crate) commit: Duration,
    pub(crate) total: Duration,
}

impl FrameTimings {
    /// Time spent on the frame itself; the rest of the total is waiting.
    pub(super) fn work(&self) -> Duration {
        self.extract + self.quantize + self.likelihood + self.new_place + self.filter + self.verification
    }
}

/// A stream into an open session.
#[derive(Clone, Debug)]
pub(crate) struct SessionStream {
    service: Arc<Service>,
    map: String,
    model: Arc<LoadedModel>,
    keep: Keep,
    words: Words,
    strategy: NavigationStrategy,
    /// Of a camera that sees all around.
    optics: Option<PanoramicOptics>,
    source: FrameSource,
    session_name: String,
    stream: u64,
    last_committed: Option<u64>,
    order: Arc<Mutex<Order>>,
    /// Cancelled when a later stream takes the session over.
    taken_over: CancellationToken,
    /// Room for this stream, given back with the last copy.
    _room: Arc<OwnedSemaphorePermit>,
}

/// A frame in words, on its way to the map's writer.
pub(crate) struct PreparedFrame {
    sequence: u64,
    work: Result<FrameWork, ServiceError>,
    since: Instant,
}

/// What became of a frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FrameOutcome {
    Answered(Box<FrameAnswer>),
    Refused {
        sequence: u64,
        last_committed: Option<u64>,
        error: ServiceError,
    },
    /// The stream is over.
    Ended(ServiceError),
}

impl Service {
    /// Opens a session of that name, or resumes it. An empty name is made up. `camera` is kept as it
    /// was encoded. `run` tells the robot's runs apart that localize by one name; empty if it is not said.
    pub(crate) async fn open_session(
        self: &Arc<Self>,
        map: &str,
        session: &str,
        mode: SessionMode,
        camera: Option<Vec<u8>>,
        words_hash: &str,
        run: &str,
    ) -> Result<SessionStream, ServiceError> {
        let map = map_in(map)?;
        let room = self.room_for_a_stream()?;
        let stream = self.new_stream();
        let name = match session {
            "" => None,
            name => Some(check_id("session name", name)?.to_owned()),
        };
        let run = if run.is_empty() { String::new() } else { check_id("run id", run)?.to_owned() };
        let row = self.map_row(map).await?;
        let model = self.loaded_model(&row.model).await?;
        let words = Words::declared(words_hash, &model)?;
        let MapSettings { keep, strategy, .. } = map_settings::from_json(&row.settings)?;
        // A session that is resumed keeps the camera that it began with.
        let stored = match &name {
            Some(name) => self.storage.session_camera(row.id, name).await?,
            None => None,
        };
        let optics = stored.as_deref().or(camera.as_deref()).and_then(PanoramicOptics::of_camera);
        if strategy == NavigationStrategy::Appearance && optics.is_none() {
            return Err(ServiceError::precondition(format_args!(
                "the map {map} is navigated by appearance, which takes panoramas: declare a camera that is a panorama \
                 (waypost stream --panorama), or a hyperbolic mirror with the radius of its horizon (--mirror)"
            )));
        }
        let open = self.open_map_of(&row).await?;
        let taken_over = CancellationToken::new();
        let opened_by =
            StreamOpening { run, stream, taken_over: taken_over.clone(), room: Arc::downgrade(&room) };
        let session = open.open_session(SessionOpening { name, mode, camera, stream: opened_by }).await?;
        let last_committed = session.last_committed;
        let order = Order::new(open, last_committed);
        Ok(SessionStream {
            order: Arc::new(Mutex::new(order)),
            taken_over,
            service: self.clone(),
            session_name: session_name(map, &session.name),
            map: map.to_owned(),
            model,
            keep,
            words,
            strategy,
            optics,
            source: session.source,
            stream,
            last_committed,
            _room: room,
        })
    }
}

impl Service {
    pub(super) fn room_for_a_stream(&self) -> Result<Arc<OwnedSemaphorePermit>, ServiceError> {
        Ok(Arc::new(self.streams.clone().try_acquire_owned().map_err(|_| too_many_streams())?))
    }
}

fn too_many_streams() -> ServiceError {
    ServiceError::Unavailable {
        message: format!(
            "the server has {MAX_STREAMS} streams open, and no room for more; end some that are idle, or ask again"
        ),
        retry_after: Some(STREAM_RETRY),
    }
}

impl SessionStream {
    /// `maps/{map}/sessions/{session}`.
    pub(crate) fn name(&self) -> &str {
        &self.session_name
    }

    /// Hash of the map's model.
    pub(crate) fn model_hash(&self) -> &str {
        &self.model.hash
    }

    /// Hash of the words that a robot may send.
    pub(crate) fn words_hash(&self) -> &str {
        &self.model.words_hash
    }

    /// The last frame that was durable when the stream began.
    pub(crate) fn last_committed(&self) -> Option<u64> {
        self.last_committed
    }

    /// Turns a frame into words. Frames may be prepared side by side.
    pub(crate) async fn prepare(&self, frame: Result<Frame, (u64, ServiceError)>) -> PreparedFrame {
        let since = Instant::now();
        match frame {
            Ok(frame) => {
                let sequence = frame.sequence;
                PreparedFrame { sequence, work: self.work(frame).await, since }
            }
            Err((sequence, error)) => PreparedFrame { sequence, work: Err(error), since },
        }
    }

    async fn work(&self, frame: Frame) -> Result<FrameWork, ServiceError> {
        let Frame { sequence, stamp_ns, content, odometry } = frame;
        if self.last_committed.is_some_and(|last| sequence <= last) {
            return Ok(FrameWork::Resend { sequence });
        }
        // Not worth looking at: it would be refused after the work.
        {
            let mut order = self.order();
            if let Some(resend_from) = order.comes_before_its_turn(sequence) {
                return Err(order.send_first(resend_from));
            }
        }
        let (model, stream) = (self.model.clone(), Some(self.stream));
        let (words, keep, optics) = (self.words, self.keep, self.optics);
        let observed = self.service.observe(model, content, words, keep, optics, stream).await?;
        let Observed { observation, features, media, extract, quantize } = observed;
        let session = match self.source {
            FrameSource::Session(session) => session,
            FrameSource::Localizer(_) => Localizer::SESSION,
        };
        let input = FrameInput { session, sequence, stamp_ns, odometry, observation };
        let timings = FrameTimings { extract, quantize, ..FrameTimings::default() };
        Ok(FrameWork::Fresh { input: Box::new(input), features, media, timings })
    }

    /// Hands a prepared frame to the map's writer, in the order of calls; what comes back waits for
    /// the outcome.
    pub(crate) async fn submit(&self, prepared: PreparedFrame) -> PendingOutcome {
        let PreparedFrame { sequence, work, since } = prepared;
        let work = match work {
            Ok(work) => work,
            Err(error @ ServiceError::Unavailable { .. }) => {
                let generation = self.order().generation;
                return PendingOutcome::Known(self.refused_for_now(sequence, generation, error));
            }
            Err(error) => return PendingOutcome::Known(self.refused_for_good(sequence, error)),
        };
        let map = match self.writer_for(sequence).await {
            Ok(map) => map,
            Err(outcome) => return PendingOutcome::Known(outcome),
        };
        let (reply, answer) = oneshot::channel();
        let request = FrameRequest { stream: self.stream, work, reply, since };
        let generation = self.order().hand_over(sequence);
        match map.frame(self.source, request).await {
            Ok(()) => PendingOutcome::Waiting { sequence, answer, generation },
            Err(WriterGone) => PendingOutcome::Known(self.writer_gone(sequence, generation).await),
        }
    }

    /// Waits for what the writer says.
    pub(crate) async fn outcome(&self, pending: PendingOutcome) -> FrameOutcome {
        let (sequence, generation, answer) = match pending {
            PendingOutcome::Known(outcome) => return outcome,
            PendingOutcome::Waiting { sequence, answer, generation } => (sequence, generation, answer.await),
        };
        match answer {
            Ok(Ok(answer)) => {
                let mut order = self.order();
                order.submitted.remove(&sequence);
                order.last_committed = order.last_committed.max(Some(answer.last_committed));
                if self.strategy == NavigationStrategy::Appearance {
                    self.service.grow_graph(&order.map, &self.map);
                }
                FrameOutcome::Answered(Box::new(answer))
            }
            Ok(Err(FrameFailure::Refused(error @ ServiceError::Unavailable { .. }))) => {
                self.refused_for_now(sequence, generation, error)
            }
            Ok(Err(FrameFailure::Refused(error))) => self.refused_for_good(sequence, error),
            Ok(Err(FrameFailure::Ended(error))) => FrameOutcome::Ended(error),
            Err(_) => self.writer_gone(sequence, generation).await,
        }
    }

    /// Counts what became of a frame; gives it back.
    pub(crate) fn counted(&self, outcome: FrameOutcome) -> FrameOutcome {
        self.service.metrics.frame(&outcome);
        outcome
    }

    /// The writer went away before the frame was stored: the map was deleted, or dropped from memory.
    async fn writer_gone(&self, sequence: u64, generation: u64) -> FrameOutcome {
        let edition = self.order().map.edition();
        match self.service.map_row(&self.map).await {
            Ok(row) if row.edition() != edition => FrameOutcome::Ended(self.replaced(row.edition(), edition)),
            Ok(_) => self.refused_for_now(sequence, generation, WriterGone.into()),
            Err(error @ ServiceError::NotFound { .. }) => FrameOutcome::Ended(error),
            Err(error) => self.refused_for_now(sequence, generation, error),
        }
    }

    /// Why the stream is over, when it is: also for a robot that is silent.
    pub(crate) async fn over(&self) -> ServiceError {
        loop {
            let map = self.order().map.clone();
            tokio::select! {
                () = self.service.stopping().cancelled() => return ServiceError::stopping(),
                () = self.taken_over.cancelled() => return taken_over(),
                () = map.gone() => {}
            }
            match self.service.map_row(&self.map).await {
                Err(error @ ServiceError::NotFound { .. }) => return error,
                Ok(row) if row.edition() != map.edition() => {
                    return self.replaced(row.edition(), map.edition());
                }
                // Dropped from memory: the next frame opens it again.
                Ok(_) | Err(_) => tokio::time::sleep(REOPENED_POLL).await,
            }
        }
    }

    /// The writer that frame `sequence` may go to, if it is its turn.
    async fn writer_for(&self, sequence: u64) -> Result<MapHandle, FrameOutcome> {
        {
            let order = self.order();
            match order.resend_from() {
                // With no frame out, a writer that is gone has left nothing to be overtaken.
                None if !(order.map.is_gone() && order.submitted.is_empty()) => return Ok(order.map.clone()),
                Some(resend_from) if sequence > resend_from => {
                    let error = order.send_first(resend_from);
                    drop(order);
                    return Err(self.refused(sequence, error));
                }
                None | Some(_) => {}
            }
        }
        match self.service.open_map(&self.map).await {
            Ok(map) => {
                let mut order = self.order();
                if map.edition() != order.map.edition() {
                    return Err(FrameOutcome::Ended(self.replaced(map.edition(), order.map.edition())));
                }
                order.begin_anew(map.clone());
                Ok(map)
            }
            Err(error @ ServiceError::NotFound { .. }) => Err(FrameOutcome::Ended(error)),
            Err(error) => Err(self.refused(sequence, error)),
        }
    }

    /// The map is not the one that the session was opened on.
    fn replaced(&self, now: MapEdition, before: MapEdition) -> ServiceError {
        if now.map == before.map {
            return ServiceError::unavailable(format_args!(
                "sessions were removed from the map {}; open the session anew and send what was not acknowledged",
                self.map
            ));
        }
        ServiceError::not_found(format_args!(
            "there is no map {} any more: it was deleted, and another of its name made; open a new session",
            self.map
        ))
    }

    fn refused(&self, sequence: u64, error: ServiceError) -> FrameOutcome {
        let mut order = self.order();
        order.submitted.remove(&sequence);
        FrameOutcome::Refused { sequence, last_committed: order.last_committed, error }
    }

    /// Refuses a frame that need not come again: those behind it wait for it no longer.
    fn refused_for_good(&self, sequence: u64, error: ServiceError) -> FrameOutcome {
        self.order().give_up(sequence);
        self.refused(sequence, error)
    }

    /// Refuses a frame that may succeed later, and all after it until it has come again.
    fn refused_for_now(&self, sequence: u64, generation: u64, error: ServiceError) -> FrameOutcome {
        self.order().wait_for(sequence, generation, &error);
        self.refused(sequence, error)
    }

    fn order(&self) -> MutexGuard<'_, Order> {
        self.order.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(super) fn taken_over() -> ServiceError {
    ServiceError::Aborted { message: "a later stream took this session over; this one is closed".to_owned() }
}

/// A frame that was handed over.
pub(crate) enum PendingOutcome {
    Known(FrameOutcome),
    Waiting { sequence: u64, generation: u64, answer: oneshot::Receiver<Result<FrameAnswer, FrameFailure>> },
}

impl FrameAnswer {
    /// The answer to a frame, all from its event, so that a stored one is the same.
    pub(super) fn new(
        event: &FrameEvent,
        last_committed: u64,
        closure: Option<MatchView>,
        proposal: Option<MatchView>,
        timings: Option<FrameTimings>,
    ) -> Self {
        let decision = &event.decision;
        let created = match decision.reason {
            Reason::NewPlace | Reason::BelowThreshold | Reason::GeometryRefused => decision.place,
            Reason::SamePlace | Reason::LoopClosure | Reason::TooFewWords => None,
        };
        let mut places: Vec<(PlaceId, f64)> =
            event.belief.places.iter().copied().filter(|&(place, _)| Some(place) != created).collect();
        places.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        places.truncate(ANSWERED_PLACES);
        Self {
            sequence: event.sequence,
            last_committed,
            reason: decision.reason,
            place: decision.place,
            posterior: decision.posterior,
            new_place_posterior: event.new_place_posterior,
            places,
            closure,
            proposal,
            words: event.observation.len() as u64,
            timings,
            map_pose: None,
        }
    }
}
