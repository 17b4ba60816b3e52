//! Which streams of robots are open, how many may be, and which came first.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::names::session_in;
use crate::open_map::SessionMode;
use crate::open_map::answers::FrameAnswer;

/// Streams that may be open at a time: each holds a few frames, of up to 4 MiB each.
const MAX_STREAMS: usize = 500;

/// When to ask again for a stream.
const RETRY: Duration = Duration::from_secs(5);

/// A robot's stream into a session, as people see it. Times are the server's.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StreamView {
    /// `maps/{map}/sessions/{session}`.
    pub(crate) session: String,
    pub(crate) mode: SessionMode,
    pub(crate) opened_ns: i64,
    /// Frames that were answered, those that were sent again among them.
    pub(crate) answered: u64,
    pub(crate) refused: u64,
    /// When the last frame was answered or refused.
    pub(crate) last_frame_ns: Option<i64>,
    /// How long the last frame that was decided took, from when the server had it until it was durable.
    pub(crate) last_delay: Option<Duration>,
    /// To the last frame that was answered.
    pub(crate) last_answer: Option<FrameAnswer>,
}

/// What became of a frame on a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Became<'a> {
    /// Decided, or answered from what is stored.
    Answered(&'a FrameAnswer),
    Refused,
}

/// Room for streams, their numbers, and those that are open. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct Streams {
    room: Arc<Semaphore>,
    next: Arc<AtomicU64>,
    open: Arc<Mutex<BTreeMap<u64, StreamView>>>,
}

impl Streams {
    pub(super) fn new() -> Self {
        Self { room: Arc::new(Semaphore::new(MAX_STREAMS)), next: Arc::default(), open: Arc::default() }
    }

    /// Room for one stream, until the last copy is dropped.
    pub(super) fn room(&self) -> Result<Arc<OwnedSemaphorePermit>, ServiceError> {
        let room = self.room.clone().try_acquire_owned();
        Ok(Arc::new(room.map_err(|_| ServiceError::Unavailable {
            message: format!(
                "the server has {MAX_STREAMS} streams open, and no room for more; end some that are idle, or ask again"
            ),
            retry_after: Some(RETRY),
        })?))
    }

    /// A number above those of all streams before: a later stream on the same session takes it over.
    pub(super) fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }

    /// Shows the stream of that number for as long as what comes back lives.
    pub(super) fn show(&self, number: u64, session: &str, mode: SessionMode) -> ShownStream {
        let session = session.to_owned();
        let view = StreamView {
            session,
            mode,
            opened_ns: now_ns(),
            answered: 0,
            refused: 0,
            last_frame_ns: None,
            last_delay: None,
            last_answer: None,
        };
        self.open().insert(number, view);
        ShownStream { streams: self.clone(), number }
    }

    /// Those into maps that are wanted, by when they were opened.
    pub(super) fn of_maps(&self, is_wanted: impl Fn(&str) -> bool) -> Vec<StreamView> {
        let is_wanted =
            |stream: &&StreamView| session_in(&stream.session).is_ok_and(|(map, _)| is_wanted(map));
        self.open().values().filter(is_wanted).cloned().collect()
    }

    /// How many are open.
    pub(super) fn count(&self) -> usize {
        self.open().len()
    }

    fn open(&self) -> MutexGuard<'_, BTreeMap<u64, StreamView>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A stream that people see.
#[derive(Debug)]
pub(super) struct ShownStream {
    streams: Streams,
    number: u64,
}

impl ShownStream {
    /// Counts a frame.
    pub(super) fn frame(&self, became: Became<'_>) {
        let mut open = self.streams.open();
        let Some(view) = open.get_mut(&self.number) else { return };
        view.last_frame_ns = Some(now_ns());
        match became {
            Became::Answered(answer) => {
                view.answered += 1;
                view.last_delay = answer.timings.map(|timings| timings.total).or(view.last_delay);
                view.last_answer = Some(answer.clone());
            }
            Became::Refused => view.refused += 1,
        }
    }
}

impl Drop for ShownStream {
    fn drop(&mut self) {
        self.streams.open().remove(&self.number);
    }
}
