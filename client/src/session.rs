//! Sessions that outlive their connections.
//!
//! The application talks to a task of its own ([`exchange`]) through two queues, and the task talks
//! to the server. What it still owes the application is in its [`window`].

use std::num::NonZeroUsize;
use std::sync::Arc;

use prost::Message;
use tokio::sync::{Semaphore, mpsc};
use tokio::task::JoinHandle;
use waypost_proto::v1;
use waypost_proto::v1::session_service_client::SessionServiceClient;

pub use backoff::Reconnection;

use crate::client::{Transport, map_name};
use crate::error::Error;
use exchange::Exchange;

pub(crate) mod backoff;
mod exchange;
mod window;

/// Frames that may be on their way at once, unless the options say otherwise.
const DEFAULT_WINDOW: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);

/// One run of one robot, being streamed into a map.
///
/// Every frame sent gets exactly one outcome, in the order of sending, through any number of broken
/// connections. To send and receive in different tasks, [`split`](Self::split) it. Dropping it
/// without [`finish`](Self::finish) gives up the frames that have no outcome yet.
#[derive(Debug)]
pub struct Session {
    sender: FrameSender,
    outcomes: Outcomes,
    opened: v1::SessionOpened,
}

/// Which session to open, and how to keep it.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// `{map}` or `maps/{map}`.
    pub map: String,
    /// Name of the session within the map. One that is there is resumed. If empty, the server makes
    /// one up.
    pub session_id: String,
    /// Whether the map grows by the session, or is only looked at.
    pub mode: v1::SessionMode,
    /// `words_hash` of the model that the robot makes its words with; empty for one that sends images. See
    /// [`v1::OpenSession`].
    pub words_hash: String,
    /// While localizing, tells this run from earlier ones by the same name, whose session then begins anew; empty
    /// to resume whatever is there. See [`v1::OpenSession`].
    pub run_id: String,
    /// How the robot sees; a session that is resumed keeps the one it began with.
    pub camera: Option<v1::Camera>,
    /// How many frames may have no outcome before sending waits. Each is kept in memory till then.
    pub window_frames: NonZeroUsize,
    /// How a broken connection is mended.
    pub reconnection: Reconnection,
}

impl SessionOptions {
    /// A new session that lets a map grow, with all defaults: images, 8 frames in flight, no camera.
    pub fn new(map: &str) -> Self {
        Self {
            map: map_name(map),
            session_id: String::new(),
            mode: v1::SessionMode::Map,
            words_hash: String::new(),
            run_id: String::new(),
            camera: None,
            window_frames: DEFAULT_WINDOW,
            reconnection: Reconnection::default(),
        }
    }
}

/// One frame of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameInput {
    /// Rises within the session; gaps are allowed. At or below the last committed number it asks for
    /// the stored answer.
    pub sequence: u64,
    /// When the image was taken, by the robot's own steady clock.
    pub stamp_ns: i64,
    /// What was seen.
    pub content: FrameContent,
    /// Pose of base_link in the session's odom frame at the stamp.
    pub odometry: Option<v1::Odometry>,
}

/// What a robot saw.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameContent {
    /// A JPEG or PNG, at most [`MAX_IMAGE_BYTES`](crate::MAX_IMAGE_BYTES); a longer one is refused
    /// without being sent.
    Image(Vec<u8>),
    /// How often each word was seen: the fewest bytes.
    Histogram(v1::WordHistogram),
    /// The word of each feature and where it is: all that can be verified by geometry.
    Words(v1::WordList),
}

impl FrameContent {
    /// Bytes that it takes on the way to the server.
    pub fn encoded_len(&self) -> usize {
        match self {
            FrameContent::Image(image) => image.len(),
            FrameContent::Histogram(histogram) => histogram.encoded_len(),
            FrameContent::Words(words) => words.encoded_len(),
        }
    }
}

/// What became of a frame.
#[expect(clippy::large_enum_variant, reason = "one at a time: a box would cost every frame an allocation")]
#[derive(Clone, Debug, PartialEq)]
pub enum FrameOutcome {
    /// It is durable, and this was decided.
    Answer(v1::FrameAnswer),
    /// It was not taken; the status says why and how to mend it.
    Refusal(v1::FrameRefusal),
}

impl FrameOutcome {
    /// Number of the frame.
    pub fn sequence(&self) -> u64 {
        match self {
            FrameOutcome::Answer(answer) => answer.sequence,
            FrameOutcome::Refusal(refusal) => refusal.sequence,
        }
    }
}

impl Session {
    pub(crate) async fn open(
        service: SessionServiceClient<Transport>,
        options: SessionOptions,
    ) -> Result<Self, Error> {
        let slots = Arc::new(Semaphore::new(options.window_frames.get()));
        let (frames, frames_to_send) = mpsc::unbounded_channel();
        let (outcomes_found, outcomes) = mpsc::unbounded_channel();
        let (exchange, opened) =
            Exchange::new(service, options, Arc::clone(&slots), frames_to_send, outcomes_found);
        let exchange = tokio::spawn(exchange.run());
        let mut outcomes = Outcomes { outcomes, exchange: Some(exchange) };
        match opened.await {
            Ok(opened) => {
                let sender = FrameSender { frames: Some(frames), slots, last_sequence: None };
                Ok(Self { sender, outcomes, opened })
            }
            Err(_never_opened) => {
                outcomes.ending().await?;
                Err(Error::Protocol("the session ended before it was opened"))
            }
        }
    }

    /// The session as the server named it, with the last frame that was durable when it was opened.
    pub fn opened(&self) -> &v1::SessionOpened {
        &self.opened
    }

    /// Sends a frame; see [`FrameSender::send`].
    ///
    /// # Errors
    /// See [`FrameSender::send`].
    pub async fn send(&mut self, frame: FrameInput) -> Result<(), Error> {
        self.sender.send(frame).await
    }

    /// The next outcome; see [`Outcomes::next`].
    ///
    /// # Errors
    /// See [`Outcomes::next`].
    pub async fn next(&mut self) -> Result<Option<FrameOutcome>, Error> {
        self.outcomes.next().await
    }

    /// Says that no more frames come. The outcomes of those sent still do.
    pub fn finish(&mut self) {
        self.sender.finish();
    }

    /// Two halves, for sending and receiving in different tasks.
    pub fn split(self) -> (FrameSender, Outcomes) {
        (self.sender, self.outcomes)
    }
}

/// The half of a session that takes frames. Dropping it says that no more come.
#[derive(Debug)]
pub struct FrameSender {
    frames: Option<mpsc::UnboundedSender<FrameInput>>,
    /// One permit per frame that may be without an outcome: this is what bounds the queue.
    slots: Arc<Semaphore>,
    last_sequence: Option<u64>,
}

impl FrameSender {
    /// Sends a frame; waits while the window is full. A window is made free by outcomes that arrive,
    /// whether the application has taken them yet or not.
    ///
    /// # Errors
    /// [`Error::SequenceNotRising`]: then the frame was not sent, and the session goes on.
    /// [`Error::SessionEnded`]: then [`Outcomes::next`] says why.
    pub async fn send(&mut self, frame: FrameInput) -> Result<(), Error> {
        let sequence = frame.sequence;
        if let Some(last) = self.last_sequence.filter(|last| *last >= sequence) {
            return Err(Error::SequenceNotRising { sequence, last });
        }
        let slot = self.slots.acquire().await.map_err(|_closed| Error::SessionEnded { sequence })?;
        let frames = self.frames.as_ref().ok_or(Error::SessionEnded { sequence })?;
        frames.send(frame).map_err(|_closed| Error::SessionEnded { sequence })?;
        // The exchange gives it back when the frame has its outcome.
        slot.forget();
        self.last_sequence = Some(sequence);
        Ok(())
    }

    /// Says that no more frames come.
    pub fn finish(&mut self) {
        self.frames = None;
    }
}

/// The half of a session that yields outcomes. Dropping it ends the session at once.
#[derive(Debug)]
pub struct Outcomes {
    outcomes: mpsc::UnboundedReceiver<FrameOutcome>,
    /// Gone when its ending has been told.
    exchange: Option<JoinHandle<Result<(), Error>>>,
}

impl Outcomes {
    /// The outcome of the next frame, in the order of sending. None when the session was finished and
    /// every frame has had its outcome, and after an error.
    ///
    /// # Errors
    /// [`Error::Status`] if the server ended the session: ABORTED when another stream took it over,
    /// NOT_FOUND when its map was deleted. [`Error::SessionLost`] if the server stayed away, or asked to
    /// send a frame again, for too long. [`Error::SessionRewound`] if it came back with older data.
    /// Frames without an outcome may be durable all the same: a session that is opened again says so.
    pub async fn next(&mut self) -> Result<Option<FrameOutcome>, Error> {
        match self.outcomes.recv().await {
            Some(outcome) => Ok(Some(outcome)),
            None => self.ending().await.map(|()| None),
        }
    }

    async fn ending(&mut self) -> Result<(), Error> {
        let Some(exchange) = self.exchange.as_mut() else { return Ok(()) };
        let ended = exchange.await;
        self.exchange = None;
        match ended {
            Ok(ending) => ending,
            Err(failure) => match failure.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                Err(_cancelled) => Err(Error::Protocol("the runtime was shut down under the session")),
            },
        }
    }
}

impl Drop for Outcomes {
    fn drop(&mut self) {
        if let Some(exchange) = &self.exchange {
            exchange.abort();
        }
    }
}
