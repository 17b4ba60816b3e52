//! Frames of one map that are sent to another, as their robots would have.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::pin::pin;
use std::sync::Arc;

use bytes::Bytes;
use futures::stream::{self, StreamExt};
use topomap::ids::SessionId;
use topomap::log::FrameEvent;

use super::Rebuilding;
use crate::error::ServiceError;
use crate::ingest::FeatureRecord;
use crate::ingest::content::{Content, Described, WordList};
use crate::names::map_name;
use crate::open_map::{Opener, SessionMode};
use crate::service::sessions::{self, Frame, FrameOutcome, Robot, SessionStream, Windows};
use crate::storage::{MapId, MapRow, MediumKind, StorageError, StoredSession};

/// Nobody waits for an answer, so as many frames as share a commit well.
const WINDOWS: Windows = Windows { prepared: 4, submitted: 32 };

/// What is sent, and where.
pub(super) struct Resending {
    /// The map that the sessions are of.
    pub(super) source: MapRow,
    pub(super) sessions: Vec<StoredSession>,
    /// Name of the new map.
    pub(super) into: String,
    pub(super) without_content: WithoutContent,
}

/// What becomes of a frame of which neither the image nor descriptors can be read.
pub(super) enum WithoutContent {
    /// The new map has other words, so there is nothing to send.
    Refuse,
    /// Its words are sent: the new map has the same, of this hash.
    SendWords(String),
}

/// A frame, and where what is kept of it lies.
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
            let stored = stored.ok_or_else(|| ServiceError::internal("a session is not in the table"))?;
            let map = map_name(&resending.into);
            let camera = stored.camera.clone();
            let words_hash = match &resending.without_content {
                WithoutContent::Refuse => "",
                WithoutContent::SendWords(hash) => hash,
            };
            let robot = Robot { words_hash, run: "", opener: Opener::SERVER };
            let opened = self.sessions.open(&map, &stored.name, SessionMode::Map, camera, robot).await?;
            stream.insert(Arc::new(opened));
        }
        Ok(())
    }

    /// Sends frames of sessions that are open, but for those that the new map has already.
    pub(super) async fn send(
        &self,
        resending: &Resending,
        streams: &Streams,
        frames: Vec<KeptFrame>,
    ) -> Result<(), ServiceError> {
        let committed = |frame: &KeptFrame| {
            let last = streams.get(&frame.event.session).and_then(|stream| stream.last_committed());
            last.is_some_and(|last| frame.event.sequence <= last)
        };
        let read = |frame: KeptFrame| async move {
            let stream = streams.get(&frame.event.session);
            let stream = stream.ok_or_else(|| ServiceError::internal("a frame of no session"))?;
            let content = self.content(resending, &frame).await?;
            let KeptFrame { event, note, map: _ } = frame;
            let FrameEvent { sequence, stamp_ns, odometry, .. } = event;
            Ok::<_, ServiceError>((stream.clone(), Ok(Frame { sequence, stamp_ns, content, odometry, note })))
        };
        let left = frames.into_iter().filter(|frame| !committed(frame));
        let frames = stream::iter(left).map(read).buffered(WINDOWS.prepared);
        let mut outcomes = pin!(sessions::run(frames, WINDOWS));
        while let Some(outcome) = outcomes.next().await {
            match outcome? {
                FrameOutcome::Answered(_) => {}
                FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error) => return Err(error),
            }
        }
        Ok(())
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
            (Some(features), WithoutContent::SendWords(_)) => Ok(Content::Words(WordList::of(&features))),
            (None, WithoutContent::SendWords(_)) => {
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

    /// Something that is kept of a frame; none if it is damaged, and the frame's words will do.
    async fn medium(
        &self,
        resending: &Resending,
        frame: &KeptFrame,
        kind: MediumKind,
    ) -> Result<Option<Vec<u8>>, ServiceError> {
        match (self.maps.storage.medium(frame.map, frame.event.frame, kind).await, &resending.without_content)
        {
            (Ok(medium), _) => Ok(medium),
            (Err(StorageError::Rot(_)), WithoutContent::SendWords(_)) => Ok(None),
            (Err(error), _) => Err(error.into()),
        }
    }
}
