//! What can be asked of a map's writer.

use std::sync::{Arc, Weak};
use std::time::Instant;

use crate::ingest::{FeatureRecord, Tracker};
use fabmap::appearance::PlaceId;
use fabmap::likelihood::ObservationModel;
use fabmap::observation::{Observation, WordId};
use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio_util::sync::CancellationToken;
use topomap::ids::{FrameId, SessionId};
use topomap::log::{CorrectionEvent, FrameEvent};
use topomap::map::PlacePoses;
use topomap::mapper::{FrameInput, MapPose, Said};
use topomap::metric::RelativePose;
use waypost_navigation::metric::planning::{Goal, MapPosition, PlanError, Route};
use waypost_navigation::metric::settings::{LocalizationSettings, PlanningSettings};
use waypost_navigation::metric::{Look, Lookout};

use super::answers::{FrameAnswer, PlaceGraph, PlacePose, PlaceSummary, QueryAnswer, WordPlace};
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::ingest::intrinsics::Intrinsics;
use crate::metrics::FrameTimings;
use crate::quotas::Reserved;
use crate::role::Role;
use crate::storage::Medium;

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
    /// What a person says of a loop closure.
    Correct {
        request: CorrectionRequest,
        reply: oneshot::Sender<Result<CorrectionEvent, ServiceError>>,
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
        reply: oneshot::Sender<Result<Looked, ServiceError>>,
    },
    Plan {
        from: PlanFrom,
        goal: Goal,
        settings: PlanningSettings,
        reply: oneshot::Sender<Result<Route, PlanError>>,
    },
    CheckGoal {
        goal: Goal,
        settings: PlanningSettings,
        reply: oneshot::Sender<Result<(), PlanError>>,
    },
    StateHash {
        reply: oneshot::Sender<String>,
    },
    Poses {
        reply: oneshot::Sender<Box<PlacePoses>>,
    },
    /// Where some places are, in their order.
    PosesOf {
        places: Vec<PlaceId>,
        reply: oneshot::Sender<Vec<Option<PlacePose>>>,
    },
    /// Up to `count` places, and where the next one is.
    Places {
        wanted: PlacesWanted,
        count: u32,
        reply: oneshot::Sender<(Vec<PlaceSummary>, Option<PlaceId>)>,
    },
    /// By number: the first frame that each place learnt from; and how places make observations.
    PlaceOrder {
        reply: oneshot::Sender<FirstFrames>,
    },
    PlaceGraph {
        reply: oneshot::Sender<Box<PlaceGraph>>,
    },
    /// What some places usually show, in their order; nothing of places that do not exist.
    UsualLooks {
        places: Vec<PlaceId>,
        reply: oneshot::Sender<Vec<Observation>>,
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

/// See [`Read::PlaceOrder`].
pub(crate) type FirstFrames = (Vec<Option<(SessionId, FrameId)>>, Arc<ObservationModel>);

/// Which places are listed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlacesWanted {
    pub(crate) from: PlaceId,
    /// The last; all if `None`.
    pub(crate) to: Option<PlaceId>,
    /// Those whose number this divides; at least 1.
    pub(crate) every: u32,
    pub(crate) within: Option<PlaceBounds>,
}

/// A rectangle of a part of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlaceBounds {
    pub(crate) part: PlaceId,
    pub(crate) x_m: [f64; 2],
    pub(crate) y_m: [f64; 2],
}

impl PlaceBounds {
    pub(super) fn has(&self, PlacePose { part, pose }: &PlacePose) -> bool {
        let Self { part: of, x_m: [left, right], y_m: [bottom, top] } = *self;
        *part == of && (left..=right).contains(&pose.x_m()) && (bottom..=top).contains(&pose.y_m())
    }
}

/// A frame of a robot that is led, and what is remembered of those before.
#[derive(Debug)]
pub(crate) struct LookRequest {
    pub(crate) lookout: Lookout,
    pub(crate) tracker: Tracker,
    pub(crate) episode: u64,
    pub(crate) settings: LocalizationSettings,
    pub(crate) input: FrameInput,
    pub(crate) features: Option<Arc<FeatureRecord>>,
    pub(crate) intrinsics: Intrinsics,
}

/// What a robot that is led saw, and what is remembered for its next frame.
#[derive(Debug)]
pub(crate) struct Looked {
    pub(crate) lookout: Lookout,
    pub(crate) tracker: Tracker,
    pub(crate) look: Look,
}

/// Where a way begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PlanFrom {
    Place(PlaceId),
    Robot(MapPosition),
}

/// What a person says of a loop closure.
#[derive(Debug)]
pub(crate) struct CorrectionRequest {
    pub(crate) verdict: Verdict,
    pub(crate) said: Said,
}

/// What is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// The frame was not at the place that it closed a loop with.
    Withdrawn { frame: FrameId },
    /// Both frames were at one place.
    Confirmed { frame: FrameId, matched: FrameId },
    /// The correction at this position was wrong.
    Undone { correction: u64 },
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
    pub(crate) camera: Option<Camera>,
    pub(crate) stream: StreamOpening,
}

/// Who opens a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Opener {
    /// Name of its token, if it has one.
    pub(crate) token: Option<String>,
    pub(crate) role: Role,
}

impl Opener {
    /// The server itself.
    pub(crate) const SERVER: Self = Self { token: None, role: Role::Admin };

    /// Refuses a session that another token opened.
    pub(super) fn check(&self, session: &str, owner: Option<&str>) -> Result<(), ServiceError> {
        match (self.role, owner) {
            (Role::Admin, _) | (Role::Robot | Role::Reader, None) => Ok(()),
            (Role::Robot | Role::Reader, Some(owner)) if self.token.as_deref() == Some(owner) => Ok(()),
            (Role::Robot | Role::Reader, Some(owner)) => Err(ServiceError::PermissionDenied {
                message: format!(
                    "the session {session} is of the token {owner}, which opened it; choose another name for yours, or \
                     ask who runs the server for a token of that name if it is the same robot"
                ),
            }),
        }
    }
}

/// The stream that wants it.
#[derive(Debug)]
pub(crate) struct StreamOpening {
    pub(crate) opener: Opener,
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

/// Number of a localizer, that of the stream that began it: never given again while the server runs, also
/// if the map is opened again.
pub(crate) type LocalizerId = u64;

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
        note: String,
        timings: FrameTimings,
        /// For what it keeps, if it keeps anything, until that is on the disk.
        room: Option<Box<Reserved>>,
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
    /// Name of the token that it is of.
    pub(crate) owner: Option<String>,
    pub(crate) last_committed: Option<u64>,
}
