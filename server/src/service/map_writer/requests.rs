//! What can be asked of a map's writer.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use fabmap::appearance::PlaceId;
use fabmap::explanation::Explanation;
use fabmap::observation::{Observation, WordId};
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};
use tokio_util::sync::CancellationToken;
use topomap::event::{FrameEvent, FrameId, SessionId};
use topomap::mapper::{FrameInput, MapPose};
use topomap::navigation::planning::{Goal, MapPosition, PlanError, Route};
use topomap::navigation::settings::{LocalizationSettings, PlanningSettings};
use topomap::navigation::{Look, Lookout};
use topomap::place_poses::PlacePoses;
use topomap::relative_pose::RelativePose;
use waypost_vision::feature_record::FeatureRecord;

use super::localizers::LocalizerId;
use crate::error::ServiceError;
use crate::service::appearance::GrowingGraph;
use crate::service::camera::Intrinsics;
use crate::service::maps::PlacePose;
use crate::service::sessions::{FrameAnswer, FrameTimings, MatchView};
use crate::storage::{MapEdition, MapId, Medium};

/// Requests that wait for a map's writer, at most; senders wait beyond that.
pub(super) const QUEUE: usize = 128;

pub(crate) enum MapRequest {
    /// The next frame of a session of the log.
    Frame(SessionId, FrameRequest),
    OpenSession {
        opening: SessionOpening,
        reply: oneshot::Sender<Result<OpenedSession, ServiceError>>,
    },
    /// What a robot measured by itself.
    Measure {
        frames: Box<MeasuredFrames>,
        reply: oneshot::Sender<Result<Option<MapPose>, ServiceError>>,
    },
    /// Changes nothing, and is answered from what is on the disk.
    Read(Read),
    /// Commit, checkpoint, end.
    Close,
    /// The same, unless robots localize in the map: what they know would be lost. Tells whether it ends.
    CloseUnused(oneshot::Sender<bool>),
}

pub(crate) enum Read {
    /// The next frame of a robot that only looks.
    Localize(LocalizerId, FrameRequest),
    Query {
        observation: Observation,
        features: Option<Arc<FeatureRecord>>,
        /// 0 if nothing is to be explained.
        explained_words: usize,
        reply: oneshot::Sender<Result<QueryAnswer, ServiceError>>,
    },
    /// The next frame of a robot that is led along the map.
    Look {
        request: Box<LookRequest>,
        reply: oneshot::Sender<Result<(Lookout, Look), ServiceError>>,
    },
    Plan {
        from: PlanFrom,
        goal: Goal,
        settings: PlanningSettings,
        reply: oneshot::Sender<Result<Route, PlanError>>,
    },
    StateHash {
        reply: oneshot::Sender<String>,
    },
    Poses {
        reply: oneshot::Sender<Box<PlacePoses>>,
    },
    Places {
        from: PlaceId,
        count: u32,
        reply: oneshot::Sender<(Vec<PlaceSummary>, u32)>,
    },
    Place {
        place: PlaceId,
        reply: oneshot::Sender<Option<PlaceSummary>>,
    },
    WordPlaces {
        word: WordId,
        from: PlaceId,
        count: u32,
        reply: oneshot::Sender<Vec<WordPlace>>,
    },
}

/// A frame of a robot that is led, and what is remembered of those before.
#[derive(Debug)]
pub(crate) struct LookRequest {
    pub(crate) lookout: Lookout,
    pub(crate) episode: u64,
    pub(crate) settings: LocalizationSettings,
    pub(crate) input: FrameInput,
    pub(crate) features: Option<Arc<FeatureRecord>>,
    pub(crate) intrinsics: Intrinsics,
}

/// Where a way begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PlanFrom {
    Place(PlaceId),
    Robot(MapPosition),
}

/// Two frames of the log, and how they lie to each other.
#[derive(Debug)]
pub(crate) struct MeasuredFrames {
    pub(crate) later: FrameEvent,
    /// The one before it in its session.
    pub(crate) before: Option<FrameEvent>,
    pub(crate) earlier: FrameEvent,
    pub(crate) pose: RelativePose,
}

/// Which session a stream wants.
#[derive(Debug)]
pub(crate) struct SessionOpening {
    /// Made up if `None`.
    pub(crate) name: Option<String>,
    pub(crate) mode: SessionMode,
    /// As it was encoded.
    pub(crate) camera: Option<Vec<u8>>,
    pub(crate) stream: StreamOpening,
}

/// The stream that wants it.
#[derive(Debug)]
pub(crate) struct StreamOpening {
    /// Run of the robot; empty if it did not say.
    pub(crate) run: String,
    pub(crate) stream: u64,
    /// Cancelled when a later stream takes the session over.
    pub(crate) taken_over: CancellationToken,
    /// Gone when the stream is closed.
    pub(crate) room: Weak<OwnedSemaphorePermit>,
}

/// What a session does with the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SessionMode {
    /// Lets it grow.
    Map,
    /// Looks at it.
    Localize,
}

/// Whose frame it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameSource {
    /// A session of the log.
    Session(SessionId),
    /// A robot that only looks.
    Localizer(LocalizerId),
}

pub(crate) type FrameReply = oneshot::Sender<Result<FrameAnswer, FrameFailure>>;

pub(crate) struct FrameRequest {
    pub(crate) stream: u64,
    pub(crate) work: FrameWork,
    pub(crate) reply: FrameReply,
    /// When the frame came in.
    pub(crate) since: Instant,
}

/// What is to be done with a frame.
pub(crate) enum FrameWork {
    /// It was committed before, says its number: find the stored answer.
    Resend { sequence: u64 },
    /// Decide it.
    Fresh {
        input: Box<FrameInput>,
        features: Option<Arc<FeatureRecord>>,
        media: Vec<Medium>,
        timings: FrameTimings,
    },
}

impl FrameWork {
    pub(crate) fn sequence(&self) -> u64 {
        match self {
            FrameWork::Resend { sequence } => *sequence,
            FrameWork::Fresh { input, .. } => input.sequence,
        }
    }
}

/// Why a frame got no answer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FrameFailure {
    /// This frame was not taken; the next may be.
    Refused(ServiceError),
    /// The stream is over.
    Ended(ServiceError),
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OpenedSession {
    pub(crate) source: FrameSource,
    pub(crate) name: String,
    pub(crate) last_committed: Option<u64>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlaceSummary {
    pub(crate) place: PlaceId,
    pub(crate) looks: u8,
    /// Ascending by word.
    pub(crate) word_hits: Vec<(WordId, u8)>,
    pub(crate) frames: Vec<FrameId>,
    pub(crate) linked: Vec<PlaceId>,
    pub(crate) pose: Option<PlacePose>,
}

/// A place that has shown a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct WordPlace {
    pub(crate) place: PlaceId,
    pub(crate) hits: u8,
    pub(crate) looks: u8,
}

/// Where one observation was made.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct QueryAnswer {
    /// The most probable places, most probable first.
    pub(crate) places: Vec<(PlaceId, f64)>,
    pub(crate) new_place_posterior: f64,
    pub(crate) matched: Option<MatchView>,
    pub(crate) accepted: bool,
    pub(crate) words: u64,
    pub(crate) explanation: Option<Explanation>,
}

/// A way to an open map's writer. Cheap to clone; the writer ends when all are gone.
#[derive(Clone, Debug)]
pub(crate) struct MapHandle {
    edition: MapEdition,
    requests: mpsc::Sender<MapRequest>,
    usage: Arc<Usage>,
    /// Beside the writer, which knows nothing of it.
    appearance: Arc<GrowingGraph>,
}

/// How an open map is used.
#[derive(Debug)]
pub(crate) struct Usage {
    last_asked: Mutex<Instant>,
    memory_bytes: AtomicU64,
}

impl Usage {
    fn new() -> Self {
        Self { last_asked: Mutex::new(Instant::now()), memory_bytes: AtomicU64::new(0) }
    }

    pub(super) fn set_memory_bytes(&self, memory_bytes: u64) {
        self.memory_bytes.store(memory_bytes, Ordering::Relaxed);
    }

    pub(super) fn memory_bytes(&self) -> u64 {
        self.memory_bytes.load(Ordering::Relaxed)
    }

    /// When the map was last asked for anything.
    pub(super) fn last_asked(&self) -> Instant {
        *self.last_asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn asked(&self) {
        *self.last_asked.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }
}

/// The writer is gone: a commit failed, the map was deleted, or the server is stopping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WriterGone;

impl From<WriterGone> for ServiceError {
    fn from(WriterGone: WriterGone) -> Self {
        ServiceError::unavailable("the map is being opened anew; send the request again")
    }
}

impl MapHandle {
    pub(in crate::service) fn new(edition: MapEdition, requests: mpsc::Sender<MapRequest>) -> Self {
        Self { edition, requests, usage: Arc::new(Usage::new()), appearance: Arc::default() }
    }

    /// What the map's panoramas have in common.
    pub(crate) fn appearance(&self) -> &Arc<GrowingGraph> {
        &self.appearance
    }

    /// What the open map takes, its graph of panoramas included.
    pub(super) fn memory_bytes(&self) -> u64 {
        self.usage.memory_bytes() + self.appearance.memory_bytes()
    }

    pub(super) fn usage(&self) -> &Arc<Usage> {
        &self.usage
    }

    pub(crate) fn id(&self) -> MapId {
        self.edition.map
    }

    /// The map, as often told anew as when it was opened.
    pub(crate) fn edition(&self) -> MapEdition {
        self.edition
    }

    /// Completes when the writer has ended.
    pub(crate) async fn gone(&self) {
        self.requests.closed().await;
    }

    pub(crate) fn is_gone(&self) -> bool {
        self.requests.is_closed()
    }

    /// Asks the writer to end after what is queued; sessions may still hold handles.
    pub(super) async fn close(&self) {
        // An error means that it has ended already.
        let _ = self.requests.send(MapRequest::Close).await;
    }

    /// Asks the writer to end unless robots localize by it; whether it does.
    pub(super) async fn close_unused(&self) -> bool {
        let (reply, ends) = oneshot::channel();
        let asked = self.requests.send(MapRequest::CloseUnused(reply)).await;
        asked.is_err() || ends.await.unwrap_or(true)
    }

    /// Hands a frame over; the answer comes by the request's reply.
    pub(crate) async fn frame(&self, source: FrameSource, request: FrameRequest) -> Result<(), WriterGone> {
        self.usage.asked();
        let request = match source {
            FrameSource::Session(session) => MapRequest::Frame(session, request),
            FrameSource::Localizer(localizer) => MapRequest::Read(Read::Localize(localizer, request)),
        };
        self.requests.send(request).await.map_err(|_| WriterGone)
    }

    pub(crate) async fn open_session(&self, opening: SessionOpening) -> Result<OpenedSession, ServiceError> {
        self.ask(|reply| MapRequest::OpenSession { opening, reply }).await?
    }

    /// Where the robot of the later frame's session is, with what was measured; durable by then.
    pub(crate) async fn measure(&self, frames: MeasuredFrames) -> Result<Option<MapPose>, ServiceError> {
        self.ask(|reply| MapRequest::Measure { frames: Box::new(frames), reply }).await?
    }

    /// Where an observation was made; explained by up to `explained_words` for and against.
    pub(crate) async fn query(
        &self,
        observation: Observation,
        features: Option<Arc<FeatureRecord>>,
        explained_words: usize,
    ) -> Result<QueryAnswer, ServiceError> {
        self.read(|reply| Read::Query { observation, features, explained_words, reply }).await?
    }

    /// What a frame shows to a robot that is led, and what is to be remembered of it.
    pub(crate) async fn look(&self, request: LookRequest) -> Result<(Lookout, Look), ServiceError> {
        self.read(|reply| Read::Look { request: Box::new(request), reply }).await?
    }

    /// Which way leads to a goal.
    pub(crate) async fn plan(
        &self,
        from: PlanFrom,
        goal: Goal,
        settings: PlanningSettings,
    ) -> Result<Result<Route, PlanError>, WriterGone> {
        self.read(|reply| Read::Plan { from, goal, settings, reply }).await
    }

    /// Hash of all that the map's log decided.
    pub(crate) async fn state_hash(&self) -> Result<String, ServiceError> {
        Ok(self.read(|reply| Read::StateHash { reply }).await?)
    }

    /// Where places are.
    pub(crate) async fn poses(&self) -> Result<Box<PlacePoses>, ServiceError> {
        Ok(self.read(|reply| Read::Poses { reply }).await?)
    }

    /// Up to `count` places from `from` on, and how many there are in all.
    pub(crate) async fn places(
        &self,
        from: PlaceId,
        count: u32,
    ) -> Result<(Vec<PlaceSummary>, u32), ServiceError> {
        Ok(self.read(|reply| Read::Places { from, count, reply }).await?)
    }

    pub(crate) async fn place(&self, place: PlaceId) -> Result<Option<PlaceSummary>, ServiceError> {
        Ok(self.read(|reply| Read::Place { place, reply }).await?)
    }

    /// Up to `count` places from `from` on that have shown a word.
    pub(crate) async fn word_places(
        &self,
        word: WordId,
        from: PlaceId,
        count: u32,
    ) -> Result<Vec<WordPlace>, ServiceError> {
        Ok(self.read(|reply| Read::WordPlaces { word, from, count, reply }).await?)
    }

    async fn read<T>(&self, read: impl FnOnce(oneshot::Sender<T>) -> Read) -> Result<T, WriterGone> {
        self.ask(|reply| MapRequest::Read(read(reply))).await
    }

    async fn ask<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> MapRequest) -> Result<T, WriterGone> {
        self.usage.asked();
        let (reply, answer) = oneshot::channel();
        self.requests.send(request(reply)).await.map_err(|_| WriterGone)?;
        answer.await.map_err(|_| WriterGone)
    }
}
