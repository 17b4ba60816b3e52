//! Sessions: a robot's stream of frames into a map.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use fabmap::appearance::PlaceId;
use tokio::sync::oneshot;
use topomap::event::{FrameEvent, Reason, SessionId};
use topomap::mapper::FrameInput;
use topomap::odometry::Odometry;

use super::Service;
use super::map_writer::{FrameFailure, FrameRequest, FrameWork, MapHandle, WriterGone};
use super::maps::FrameReference;
use super::names::{check_id, map_in, session_name};
use crate::error::ServiceError;
use crate::extraction::{LoadedModel, Observed};

/// Most places that an answer lists.
const ANSWERED_PLACES: usize = 10;

/// A frame as a robot sends it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    pub(crate) image: Bytes,
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
}

/// An earlier frame of a place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatchView {
    pub(crate) place: PlaceId,
    pub(crate) posterior: f64,
    pub(crate) log_odds: f64,
    pub(crate) frame: FrameReference,
}

/// Where a frame's time went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FrameTimings {
    pub(crate) extract: Duration,
    pub(crate) quantize: Duration,
    pub(crate) likelihood: Duration,
    pub(crate) new_place: Duration,
    pub(crate) filter: Duration,
    pub(crate) commit: Duration,
    pub(crate) total: Duration,
}

/// A stream into an open session.
#[derive(Clone, Debug)]
pub(crate) struct SessionStream {
    service: Arc<Service>,
    map: String,
    model: Arc<LoadedModel>,
    session: SessionId,
    session_name: String,
    stream: u64,
    last_committed: Option<u64>,
    order: Arc<Mutex<Order>>,
}

/// Keeps frames from overtaking one that must be sent again: a later number, once committed, would
/// shut it out for good.
#[derive(Debug)]
struct Order {
    /// The map's writer that this stream submits to. A new one is taken only to resend.
    map: MapHandle,
    /// Handed over and not yet answered.
    submitted: BTreeSet<u64>,
    /// The frame that must come next, because it was refused only for now.
    resend_from: Option<u64>,
    last_committed: Option<u64>,
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
    /// was encoded.
    pub(crate) async fn open_session(
        self: &Arc<Self>,
        map: &str,
        session: &str,
        camera: Option<Vec<u8>>,
    ) -> Result<SessionStream, ServiceError> {
        let map = map_in(map)?;
        let stream = self.new_stream();
        let row = self.map_row(map).await?;
        let model = self.loaded_model(&row.model).await?;
        let open = self.open_map(map).await?;
        let id = if session.is_empty() { self.new_session_id(&open).await? } else { session.to_owned() };
        check_id("session name", &id)?;
        let session = open.open_session(id.clone(), camera, stream).await?;
        let last_committed = session.last_committed;
        let order = Order { map: open, submitted: BTreeSet::new(), resend_from: None, last_committed };
        Ok(SessionStream {
            order: Arc::new(Mutex::new(order)),
            service: self.clone(),
            session_name: session_name(map, &id),
            map: map.to_owned(),
            model,
            session: session.session,
            stream,
            last_committed,
        })
    }

    async fn new_session_id(&self, map: &MapHandle) -> Result<String, ServiceError> {
        let sessions = self.storage.sessions(map.id()).await?;
        let taken = |id: &String| sessions.iter().any(|session| session.name == *id);
        let unused = (sessions.len()..).map(|number| format!("session-{number}")).find(|id| !taken(id));
        unused.ok_or(ServiceError::Internal)
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
        let Frame { sequence, stamp_ns, image, odometry } = frame;
        if self.last_committed.is_some_and(|last| sequence <= last) {
            return Ok(FrameWork::Resend { sequence });
        }
        let Observed { observation, extract, quantize } =
            self.service.extraction.observe(self.model.clone(), image).await?;
        let input = FrameInput { session: self.session, sequence, stamp_ns, odometry, observation };
        let timings = FrameTimings { extract, quantize, ..FrameTimings::default() };
        Ok(FrameWork::Fresh { input: Box::new(input), timings })
    }

    /// Hands a prepared frame to the map's writer, in the order of calls; what comes back waits for
    /// the outcome.
    pub(crate) async fn submit(&self, prepared: PreparedFrame) -> PendingOutcome {
        let PreparedFrame { sequence, work, since } = prepared;
        let work = match work {
            Ok(work) => work,
            Err(error) => return PendingOutcome::Known(self.refused(sequence, error)),
        };
        let map = match self.writer_for(sequence).await {
            Ok(map) => map,
            Err(outcome) => return PendingOutcome::Known(outcome),
        };
        let (reply, answer) = oneshot::channel();
        let request = FrameRequest { session: self.session, stream: self.stream, work, reply, since };
        self.order().submitted.insert(sequence);
        match map.frame(request).await {
            Ok(()) => PendingOutcome::Waiting { sequence, answer },
            Err(WriterGone) => PendingOutcome::Known(self.writer_gone(sequence).await),
        }
    }

    /// Waits for what the writer says.
    pub(crate) async fn outcome(&self, pending: PendingOutcome) -> FrameOutcome {
        let (sequence, answer) = match pending {
            PendingOutcome::Known(outcome) => return outcome,
            PendingOutcome::Waiting { sequence, answer } => (sequence, answer.await),
        };
        match answer {
            Ok(Ok(answer)) => {
                let mut order = self.order();
                order.submitted.remove(&sequence);
                order.last_committed = order.last_committed.max(Some(answer.last_committed));
                FrameOutcome::Answered(Box::new(answer))
            }
            Ok(Err(FrameFailure::Refused(error @ ServiceError::Unavailable { .. }))) => {
                self.refused_for_now(sequence, error)
            }
            Ok(Err(FrameFailure::Refused(error))) => self.refused(sequence, error),
            Ok(Err(FrameFailure::Ended(error))) => FrameOutcome::Ended(error),
            Err(_) => self.writer_gone(sequence).await,
        }
    }

    /// The writer went away before the frame was stored: the map was deleted, or dropped from memory.
    async fn writer_gone(&self, sequence: u64) -> FrameOutcome {
        match self.service.map_row(&self.map).await {
            Ok(_) => self.refused_for_now(sequence, WriterGone.into()),
            Err(error @ ServiceError::NotFound { .. }) => FrameOutcome::Ended(error),
            Err(error) => self.refused_for_now(sequence, error),
        }
    }

    /// The writer that frame `sequence` may go to, if it is its turn.
    async fn writer_for(&self, sequence: u64) -> Result<MapHandle, FrameOutcome> {
        let resend_from = {
            let order = self.order();
            match order.resend_from {
                None => return Ok(order.map.clone()),
                Some(resend_from) => resend_from,
            }
        };
        if sequence > resend_from {
            let error = ServiceError::unavailable(format_args!(
                "frame {resend_from} must be sent again first, then this one"
            ));
            return Err(self.refused(sequence, error));
        }
        match self.service.open_map(&self.map).await {
            Ok(map) => {
                let mut order = self.order();
                (order.map, order.resend_from) = (map.clone(), None);
                Ok(map)
            }
            Err(error @ ServiceError::NotFound { .. }) => Err(FrameOutcome::Ended(error)),
            Err(error) => Err(self.refused(sequence, error)),
        }
    }

    fn refused(&self, sequence: u64, error: ServiceError) -> FrameOutcome {
        let mut order = self.order();
        order.submitted.remove(&sequence);
        FrameOutcome::Refused { sequence, last_committed: order.last_committed, error }
    }

    /// Refuses a frame that may succeed later, and all after it until it has come again.
    fn refused_for_now(&self, sequence: u64, error: ServiceError) -> FrameOutcome {
        let mut order = self.order();
        let first = order.submitted.first().map_or(sequence, |&first| first.min(sequence));
        order.resend_from = Some(order.resend_from.map_or(first, |before| before.min(first)));
        drop(order);
        self.refused(sequence, error)
    }

    fn order(&self) -> MutexGuard<'_, Order> {
        self.order.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A frame that was handed over.
pub(crate) enum PendingOutcome {
    Known(FrameOutcome),
    Waiting { sequence: u64, answer: oneshot::Receiver<Result<FrameAnswer, FrameFailure>> },
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
            Reason::NewPlace | Reason::BelowThreshold => decision.place,
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
        }
    }
}
