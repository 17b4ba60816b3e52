//! Sessions: a robot's stream of frames into a map.

mod frame;
mod order;
mod pipeline;
mod preparing;
mod single;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio_util::sync::CancellationToken;

pub(super) use self::frame::check_note;
pub(crate) use self::frame::{Frame, FrameOutcome, Robot};
use self::order::Order;
pub(super) use self::pipeline::run;
pub(crate) use self::pipeline::{ReceivedFrame, RefusedFrame, Windows};
use self::preparing::PreparedFrame;
pub(super) use self::single::Turns;
use super::appearance::AppearanceGraphs;
use super::refusals::{Refusal, RefusalLog};
pub(crate) use super::streams::StreamView;
use super::streams::{Became, ShownStream, Streams};
use super::tokens::Caller;
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::ingest::content::Words;
use crate::ingest::extraction::Extraction;
use crate::ingest::intrinsics::Intrinsics;
use crate::ingest::model::{LoadedModel, LoadedModels};
use crate::ingest::panoramic::PanoramicOptics;
use crate::map_settings::{self, Keep, MapSettings, NavigationStrategy};
use crate::metrics::Metrics;
use crate::names::{check_id, map_in, session_name};
pub(crate) use crate::open_map::SessionMode;
use crate::open_map::answers::FrameAnswer;
use crate::open_map::{
    FrameFailure, FrameRequest, FrameSource, MapHandle, OpenMaps, Opener, SessionOpening, StreamOpening,
    WriterGone,
};
use crate::storage::{MapEdition, Storage};

/// The call that frames come by.
const STREAM: &str = "/waypost.v1.SessionService/Stream";

/// How often a stream whose map was dropped from memory looks whether it still exists.
const REOPENED_POLL: Duration = Duration::from_millis(500);

/// A stream into an open session.
#[derive(Debug)]
pub(crate) struct SessionStream {
    sessions: Sessions,
    map: String,
    model: Arc<LoadedModel>,
    keep: Keep,
    words: Words,
    strategy: NavigationStrategy,
    /// Of a camera that sees all around.
    optics: Option<PanoramicOptics>,
    /// Of one that looks ahead.
    intrinsics: Option<Intrinsics>,
    source: FrameSource,
    session_name: String,
    stream: u64,
    /// Whose place in line it is where there is more than can be done; none of a frame by itself.
    in_line: Option<u64>,
    /// Name of the token that it came with, if there was one: its frames count for that.
    token: Option<String>,
    /// Name of the token that the session is of: what is kept counts for that.
    owner: Option<String>,
    last_committed: Option<u64>,
    order: Mutex<Order>,
    /// Cancelled when a later stream takes the session over.
    taken_over: CancellationToken,
    shown: Option<ShownStream>,
    /// Room for this stream.
    _room: Arc<OwnedSemaphorePermit>,
}

/// Opens robots' streams into maps. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Sessions {
    pub(super) storage: Storage,
    pub(super) models: LoadedModels,
    pub(super) open_maps: OpenMaps,
    pub(super) extraction: Extraction,
    pub(super) graphs: AppearanceGraphs,
    pub(super) streams: Streams,
    pub(super) metrics: Metrics,
    pub(super) refusals: RefusalLog,
    pub(super) turns: Turns,
    pub(super) stopping: CancellationToken,
}

impl Sessions {
    /// Streams that are open into a map, or into all that the caller reaches if `map` is empty; by when they were opened.
    pub(crate) async fn open_streams(
        &self,
        caller: &Caller,
        map: &str,
    ) -> Result<Vec<StreamView>, ServiceError> {
        if map.is_empty() {
            return Ok(self.streams.of_maps(|map| caller.reach.has(map)));
        }
        let map = map_in(map)?;
        caller.check_map(map)?;
        self.open_maps.row(map).await?;
        Ok(self.streams.of_maps(|other| other == map))
    }

    /// Opens a session of that name, or resumes it. An empty name is made up.
    pub(crate) async fn open(
        &self,
        map: &str,
        session: &str,
        mode: SessionMode,
        camera: Option<Camera>,
        robot: Robot<'_>,
    ) -> Result<SessionStream, ServiceError> {
        let Robot { words_hash, run, opener } = robot;
        let map = map_in(map)?;
        let room = self.streams.room()?;
        let stream = self.streams.number();
        let name = match session {
            "" => None,
            name => Some(check_id("session name", name)?.to_owned()),
        };
        let run = if run.is_empty() { String::new() } else { check_id("run id", run)?.to_owned() };
        let row = self.open_maps.row(map).await?;
        let model = self.models.get(&row.model).await?;
        let words = Words::declared(words_hash, &model)?;
        let MapSettings { keep, strategy, .. } = map_settings::from_json(&row.settings)?;
        // A session that is resumed keeps the camera that it began with.
        let stored = match &name {
            Some(name) => self.storage.session_camera(row.id, name).await?,
            None => None,
        };
        let sees_by = stored.as_ref().or(camera.as_ref());
        let intrinsics = sees_by.and_then(Intrinsics::of_camera);
        let optics = sees_by.and_then(PanoramicOptics::of_camera);
        if strategy == NavigationStrategy::Appearance && optics.is_none() {
            return Err(ServiceError::precondition(format_args!(
                "the map {map} is navigated by appearance, which takes panoramas: declare a camera that is a panorama \
                 (waypost stream --panorama), or a hyperbolic mirror with the radius of its horizon (--mirror)"
            )));
        }
        let open = self.open_maps.open_of(&row).await?;
        let taken_over = CancellationToken::new();
        let is_seen = opener.is_some();
        let opener = opener.unwrap_or(Opener::SERVER);
        let token = opener.token.clone();
        let opened_by = StreamOpening {
            opener,
            run,
            stream,
            taken_over: taken_over.clone(),
            room: Arc::downgrade(&room),
        };
        let session = open.open_session(SessionOpening { name, mode, camera, stream: opened_by }).await?;
        let last_committed = session.last_committed;
        let order = Order::new(open, last_committed);
        let session_name = session_name(map, &session.name);
        let shown = is_seen.then(|| self.streams.show(stream, &session_name, mode));
        Ok(SessionStream {
            order: Mutex::new(order),
            taken_over,
            sessions: self.clone(),
            session_name,
            shown,
            map: map.to_owned(),
            model,
            keep,
            words,
            strategy,
            optics,
            intrinsics,
            source: session.source,
            stream,
            in_line: Some(stream),
            token,
            owner: session.owner,
            last_committed,
            _room: room,
        })
    }
}

impl SessionStream {
    /// `maps/{map}/sessions/{session}`.
    pub(crate) fn name(&self) -> &str {
        &self.session_name
    }

    /// Counts what became of a frame, and notes why it was refused.
    fn count(&self, outcome: &FrameOutcome) {
        let (counted, timings) = outcome.counted();
        self.sessions.metrics.frame(counted, timings);
        match outcome {
            FrameOutcome::Answered(answer) => {
                self.shown.iter().for_each(|shown| shown.frame(Became::Answered(answer)));
            }
            FrameOutcome::Refused { error, .. } => {
                // A frame by itself is noted with the request that brought it.
                let Some(shown) = &self.shown else { return };
                shown.frame(Became::Refused);
                let refusal = Refusal::on_stream(STREAM, &self.session_name, self.token.as_ref(), error);
                self.sessions.refusals.note(refusal);
            }
            // The call ends with it, and is noted as a whole.
            FrameOutcome::Ended(_) => {}
        }
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

    /// Hands a prepared frame to the map's writer, in the order of calls; what comes back waits for
    /// the outcome.
    async fn submit(&self, prepared: PreparedFrame) -> PendingOutcome {
        let PreparedFrame { sequence, work, since } = prepared;
        let work = match work {
            Ok(work) => work,
            Err(error) if error.is_for_now() => {
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
    async fn outcome(&self, pending: PendingOutcome) -> FrameOutcome {
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
                    self.sessions.graphs.grow(&order.map, &self.map);
                }
                FrameOutcome::Answered(Box::new(answer))
            }
            Ok(Err(FrameFailure::Refused(error))) if error.is_for_now() => {
                self.refused_for_now(sequence, generation, error)
            }
            Ok(Err(FrameFailure::Refused(error))) => self.refused_for_good(sequence, error),
            Ok(Err(FrameFailure::Ended(error))) => FrameOutcome::Ended(error),
            Err(_) => self.writer_gone(sequence, generation).await,
        }
    }

    /// The writer went away before the frame was stored: the map was deleted, or dropped from memory.
    async fn writer_gone(&self, sequence: u64, generation: u64) -> FrameOutcome {
        let edition = self.order().map.edition();
        match self.sessions.open_maps.row(&self.map).await {
            Ok(row) if row.edition() != edition => FrameOutcome::Ended(self.replaced(row.edition(), edition)),
            Ok(_) => self.refused_for_now(sequence, generation, WriterGone.into()),
            Err(error @ ServiceError::NotFound { .. }) => FrameOutcome::Ended(error),
            Err(error) => self.refused_for_now(sequence, generation, error),
        }
    }

    /// Why the stream is over, when it is: also for a robot that is silent.
    async fn over(&self) -> ServiceError {
        loop {
            let map = self.order().map.clone();
            tokio::select! {
                () = self.sessions.stopping.cancelled() => return ServiceError::stopping(),
                () = self.taken_over.cancelled() => return ServiceError::taken_over(),
                () = map.gone() => {}
            }
            match self.sessions.open_maps.row(&self.map).await {
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
        match self.sessions.open_maps.open(&self.map).await {
            Ok(map) => {
                let mut order = self.order();
                if map.edition() != order.map.edition() {
                    return Err(FrameOutcome::Ended(self.replaced(map.edition(), order.map.edition())));
                }
                order.begin_anew(map.clone());
                Ok(map)
            }
            Err(error @ ServiceError::NotFound { .. }) => Err(FrameOutcome::Ended(error)),
            // Those after it must not overtake it.
            Err(error) if error.is_for_now() => {
                let generation = self.order().generation;
                Err(self.refused_for_now(sequence, generation, error))
            }
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

/// A frame that was handed over.
enum PendingOutcome {
    Known(FrameOutcome),
    Waiting { sequence: u64, generation: u64, answer: oneshot::Receiver<Result<FrameAnswer, FrameFailure>> },
}
