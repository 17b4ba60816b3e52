//! Frames of one map that are sent to another, as their robots would have.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::stream::{self, StreamExt};
use topomap::ids::SessionId;
use topomap::log::FrameEvent;

use super::Rebuilding;
use crate::error::ServiceError;
use crate::ingest::FeatureRecord;
use crate::ingest::content::{Content, Described, WordList};
use crate::names::map_name;
use crate::open_map::SessionMode;
use crate::service::sessions::{self, Frame, FrameOutcome, Robot, SessionStream, Windows};
use crate::storage::{MapId, MapRow, MediumKind, StorageError, StoredSession};

/// Nobody waits for an answer, so as many frames as share a commit well.
const WINDOWS: Windows = Windows { prepared: 4, submitted: 32 };

/// How long what passes may keep frames from being taken, with nothing taken meanwhile.
const PATIENCE: Duration = Duration::from_secs(600);

/// After which one is sent again that was refused without a word about that.
const RETRY: Duration = Duration::from_secs(1);

/// What is sent, and where.
pub(super) struct Resending {
    /// The map that the sessions are of.
    pub(super) source: MapRow,
    pub(super) sessions: Vec<StoredSession>,
    /// Name of the new map.
    pub(super) into: String,
    pub(super) without_content: WithoutContent,
    /// What is kept of frames, and could be read nowhere.
    lost: Mutex<Vec<String>>,
}

impl Resending {
    pub(super) fn new(
        source: MapRow,
        sessions: Vec<StoredSession>,
        into: String,
        without_content: WithoutContent,
    ) -> Self {
        Self { source, sessions, into, without_content, lost: Mutex::default() }
    }

    /// Notes that something that is kept of a frame is lost.
    pub(super) fn lose(&self, what: &str, frame: &FrameEvent) {
        let session = self.sessions.iter().find(|stored| stored.number == frame.session);
        let session = session.map_or("", |stored| &stored.name);
        let lost = format!("{what} of session {session}, frame {}", frame.sequence);
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).push(lost);
    }

    /// What was lost so far.
    pub(super) fn lost(&self) -> Vec<String> {
        let mut lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // Frames are read side by side.
        lost.sort();
        lost
    }
}

/// What becomes of a frame of which neither the image nor descriptors can be read.
pub(super) enum WithoutContent {
    /// The new map has other words, so there is nothing to send.
    Refuse,
    /// Its words are sent: the new map has the same.
    SendWords {
        words_hash: String,
        /// An earlier copy of the map, with the same frames at the same positions of its log as far as it goes.
        copy: Option<MapId>,
    },
}

/// A frame, and where what is kept of it lies.
#[derive(Clone, Debug)]
pub(super) struct KeptFrame {
    pub(super) map: MapId,
    pub(super) event: FrameEvent,
    pub(super) note: String,
}

/// Streams into the new map, by the numbers that sessions have in the other.
pub(super) type Streams = HashMap<SessionId, Arc<SessionStream>>;

impl Rebuilding {
    /// Opens the session in the new map, if it is not open yet.
    pub(super) async fn open(
        &self,
        resending: &Resending,
        streams: &mut Streams,
        session: SessionId,
    ) -> Result<(), ServiceError> {
        if let Entry::Vacant(stream) = streams.entry(session) {
            let stored = resending.sessions.iter().find(|stored| stored.number == session);
            let stored = stored.ok_or_else(|| {
                ServiceError::damaged(&format!(
                    "map {}, session number {session}: its name and camera cannot be read",
                    resending.source.name
                ))
            })?;
            let map = map_name(&resending.into);
            let camera = stored.camera.clone();
            let words_hash = match &resending.without_content {
                WithoutContent::Refuse => "",
                WithoutContent::SendWords { words_hash, copy: _ } => words_hash,
            };
            let robot = Robot { words_hash, run: "", opener: None };
            let opened = self.sessions.open(&map, &stored.name, SessionMode::Map, camera, robot).await?;
            stream.insert(Arc::new(opened));
        }
        Ok(())
    }

    /// Sends frames of sessions that are open, but for those that the new map has already.
    pub(super) async fn send(
        &self,
        resending: &Arc<Resending>,
        streams: &Streams,
        frames: Vec<KeptFrame>,
    ) -> Result<(), ServiceError> {
        let committed = |frame: &KeptFrame| {
            let last = streams.get(&frame.event.session).and_then(|stream| stream.last_committed());
            last.is_some_and(|last| frame.event.sequence <= last)
        };
        let (there, mut left): (Vec<KeptFrame>, Vec<KeptFrame>) = frames.into_iter().partition(committed);
        if let WithoutContent::SendWords { .. } = resending.without_content {
            // What was lost of them is told, too, by a repair that goes on.
            for frame in &there {
                self.content(resending, frame).await?;
            }
        }
        let mut held_up_since = None;
        while let Some((answered, error)) = self.send_once(resending, streams, &left).await? {
            left.drain(..answered);
            if answered > 0 {
                held_up_since = None;
            }
            let since: Instant = *held_up_since.get_or_insert_with(Instant::now);
            if since.elapsed() > PATIENCE || self.jobs.is_stopping() {
                return Err(error);
            }
            tracing::info!(into = resending.into, %error, "frames are sent again in a moment");
            tokio::time::sleep(error.retry_after().unwrap_or(RETRY)).await;
        }
        Ok(())
    }

    /// Sends frames until one is refused for now: how many before it were taken, and why it was not.
    async fn send_once(
        &self,
        resending: &Arc<Resending>,
        streams: &Streams,
        left: &[KeptFrame],
    ) -> Result<Option<(usize, ServiceError)>, ServiceError> {
        let read = |frame: KeptFrame| {
            let stream = streams.get(&frame.event.session).cloned();
            let (rebuilding, resending) = (self.clone(), resending.clone());
            // By itself: what is half read holds a connection to the database, and nobody reads on here while the map's own
            // thread waits for one.
            let reading = tokio::spawn(async move {
                let content = rebuilding.content(&resending, &frame).await?;
                Ok::<_, ServiceError>((frame, content))
            });
            async {
                let stream = stream.ok_or_else(|| ServiceError::internal("a frame of no session"))?;
                let (frame, content) = reading.await.map_err(ServiceError::internal)??;
                let KeptFrame { event, note, map: _ } = frame;
                let FrameEvent { sequence, stamp_ns, odometry, .. } = event;
                Ok::<_, ServiceError>((stream, Ok(Frame { sequence, stamp_ns, content, odometry, note })))
            }
        };
        let frames = stream::iter(left.to_vec()).map(read).buffered(WINDOWS.prepared);
        let mut outcomes = pin!(sessions::run(frames, WINDOWS));
        let mut answered = 0;
        while let Some(outcome) = outcomes.next().await {
            match outcome? {
                FrameOutcome::Answered(_) => answered += 1,
                FrameOutcome::Refused { error, .. } if error.is_for_now() => {
                    return Ok(Some((answered, error)));
                }
                FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// What is kept of a frame that words can be made of, or its words.
    async fn content(&self, resending: &Resending, frame: &KeptFrame) -> Result<Content, ServiceError> {
        if let Some(image) = self.medium(resending, frame, MediumKind::Image).await? {
            return Ok(Content::Image(Bytes::from(image)));
        }
        let stored = self.medium(resending, frame, MediumKind::Features).await?;
        let features = stored.and_then(|bytes| FeatureRecord::from_bytes(&bytes).ok());
        match (features, &resending.without_content) {
            (Some(features), _) if features.descriptors().is_some() => {
                let thumbnail = self.medium(resending, frame, MediumKind::Thumbnail).await?;
                Ok(Content::Described(Described { features: Arc::new(features), thumbnail }))
            }
            (Some(features), WithoutContent::SendWords { .. }) => Ok(Content::Words(WordList::of(&features))),
            (None, WithoutContent::SendWords { .. }) => {
                let (words, counts) = frame.event.observation.word_counts().unzip();
                Ok(Content::Histogram { words, counts })
            }
            (_, WithoutContent::Refuse) => Err(ServiceError::precondition(format_args!(
                "of frame {} of a session of the map {} neither the image nor descriptors are kept: its robot sent words \
                 alone; remove the session from a copy of the map, or drive it again",
                frame.event.sequence, resending.source.name
            ))),
        }
    }

    /// Something that is kept of a frame; from the copy if it is damaged, and none if it is there, too.
    async fn medium(
        &self,
        resending: &Resending,
        frame: &KeptFrame,
        kind: MediumKind,
    ) -> Result<Option<Vec<u8>>, ServiceError> {
        let storage = &self.maps.storage;
        let position = frame.event.frame;
        let copy = match (storage.medium(frame.map, position, kind).await, &resending.without_content) {
            (Ok(medium), _) => return Ok(medium),
            (Err(StorageError::Rot(_)), WithoutContent::SendWords { words_hash: _, copy }) => *copy,
            (Err(error), _) => return Err(error.into()),
        };
        let copied = match copy.filter(|copy| *copy != frame.map) {
            Some(copy) => storage.medium(copy, position, kind).await,
            None => Ok(None),
        };
        match copied {
            Ok(Some(medium)) => Ok(Some(medium)),
            Ok(None) | Err(StorageError::Rot(_)) => {
                resending.lose(
                    match kind {
                        MediumKind::Image => "the image",
                        MediumKind::Features => "the features",
                        MediumKind::Thumbnail => "the thumbnail",
                    },
                    &frame.event,
                );
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }
}
