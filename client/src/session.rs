//! Sessions: frames of one robot, streamed into a map through broken connections.
//!
//! The application talks to a background task ([`exchange`]) through two queues, and the task talks
//! to the server. It keeps frames without an outcome in its [`window`].

use std::sync::Arc;

use tokio::sync::{Semaphore, mpsc};
use waypost_proto::v1;

pub use halves::{FrameSender, Outcomes};
pub use options::SessionOptions;

use crate::client::{Call, Client};
use crate::error::Error;
use crate::frame::{FrameInput, FrameOutcome};
use crate::reconnection::Task;
use exchange::SessionExchange;

mod exchange;
mod halves;
mod options;
mod window;

/// One run of one robot, streamed into a map.
///
/// Every frame gets exactly one outcome, in the order of sending, whatever happens to the
/// connection. To send and receive in different tasks, [`split`](Self::split) it. Dropping it
/// without [`finish`](Self::finish) gives up the frames that have no outcome yet.
#[derive(Debug)]
pub struct Session {
    sender: FrameSender,
    outcomes: Outcomes,
    opened: v1::SessionOpened,
}

impl Client {
    /// Opens a session, or resumes the one of that name. Waits for an unreachable server up to
    /// [`give_up_after`](crate::Reconnection::give_up_after).
    ///
    /// # Errors
    /// [`Error::Status`] if the server refuses, [`Error::SessionLost`] if it could not be reached.
    pub fn open_session(&self, options: SessionOptions) -> Call<'_, Session> {
        Box::pin(async move {
            let slots = Arc::new(Semaphore::new(options.window_frames.get()));
            let (frames, frames_to_send) = mpsc::unbounded_channel();
            let (outcomes_found, outcomes) = mpsc::unbounded_channel();
            let (exchange, opened) = SessionExchange::new(
                self.sessions_client(),
                options,
                Arc::clone(&slots),
                frames_to_send,
                outcomes_found,
            );
            // From here on, a caller that gives up waiting ends the task.
            let mut outcomes = Outcomes::new(outcomes, Task::spawn(exchange));
            let opened = outcomes.opened(opened).await?;
            Ok(Session { sender: FrameSender::new(frames, slots), outcomes, opened })
        })
    }
}

impl Session {
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
