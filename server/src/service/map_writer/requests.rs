//! What can be asked of a map's writer.

use std::time::Instant;

use fabmap::appearance::PlaceId;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;
use topomap::event::{FrameId, SessionId};
use topomap::mapper::FrameInput;

use crate::error::ServiceError;
use crate::service::sessions::{FrameAnswer, FrameTimings};
use crate::storage::MapId;

/// Requests that wait for a map's writer, at most; senders wait beyond that.
pub(super) const QUEUE: usize = 128;

pub(crate) enum MapRequest {
    Frame(FrameRequest),
    OpenSession {
        /// Made up if `None`.
        name: Option<String>,
        camera: Option<Vec<u8>>,
        stream: u64,
        taken_over: CancellationToken,
        reply: oneshot::Sender<Result<OpenedSession, ServiceError>>,
    },
    StateHash {
        reply: oneshot::Sender<String>,
    },
    Places {
        from: u32,
        count: u32,
        reply: oneshot::Sender<(Vec<PlaceSummary>, u32)>,
    },
    /// Commit, checkpoint, end.
    Close,
}

pub(crate) type FrameReply = oneshot::Sender<Result<FrameAnswer, FrameFailure>>;

pub(crate) struct FrameRequest {
    pub(crate) session: SessionId,
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
    Fresh { input: Box<FrameInput>, timings: FrameTimings },
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
    pub(crate) session: SessionId,
    pub(crate) name: String,
    pub(crate) last_committed: Option<u64>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlaceSummary {
    pub(crate) place: PlaceId,
    pub(crate) looks: u8,
    pub(crate) words: u64,
    pub(crate) frames: Vec<FrameId>,
    pub(crate) linked: Vec<PlaceId>,
}

/// A way to an open map's writer. Cheap to clone; the writer ends when all are gone.
#[derive(Clone, Debug)]
pub(crate) struct MapHandle {
    id: MapId,
    requests: mpsc::Sender<MapRequest>,
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
    pub(super) fn new(id: MapId, requests: mpsc::Sender<MapRequest>) -> Self {
        Self { id, requests }
    }

    pub(crate) fn id(&self) -> MapId {
        self.id
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

    /// Hands a frame over; the answer comes by the request's reply.
    pub(crate) async fn frame(&self, request: FrameRequest) -> Result<(), WriterGone> {
        self.requests.send(MapRequest::Frame(request)).await.map_err(|_| WriterGone)
    }

    pub(crate) async fn open_session(
        &self,
        name: Option<String>,
        camera: Option<Vec<u8>>,
        stream: u64,
        taken_over: CancellationToken,
    ) -> Result<OpenedSession, ServiceError> {
        self.ask(|reply| MapRequest::OpenSession { name, camera, stream, taken_over, reply }).await?
    }

    /// Hash of all that the map's log decided.
    pub(crate) async fn state_hash(&self) -> Result<String, ServiceError> {
        Ok(self.ask(|reply| MapRequest::StateHash { reply }).await?)
    }

    /// Up to `count` places from `from` on, and how many there are in all.
    pub(crate) async fn places(
        &self,
        from: u32,
        count: u32,
    ) -> Result<(Vec<PlaceSummary>, u32), ServiceError> {
        Ok(self.ask(|reply| MapRequest::Places { from, count, reply }).await?)
    }

    async fn ask<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> MapRequest) -> Result<T, WriterGone> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(request(reply)).await.map_err(|_| WriterGone)?;
        answer.await.map_err(|_| WriterGone)
    }
}
