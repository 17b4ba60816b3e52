//! The two halves of a session: one takes frames, the other yields outcomes.

use std::sync::Arc;

use tokio::sync::{Semaphore, mpsc, oneshot};
use waypost_proto::v1;

use crate::error::Error;
use crate::frame::{FrameInput, FrameOutcome};
use crate::reconnection::Task;

/// The half of a session that takes frames. Dropping it says that no more come.
#[derive(Debug)]
pub struct FrameSender {
    frames: Option<mpsc::UnboundedSender<FrameInput>>,
    /// One permit for each frame that may be without an outcome. They bound the queue.
    slots: Arc<Semaphore>,
    last_sequence: Option<u64>,
}

impl FrameSender {
    pub(super) fn new(frames: mpsc::UnboundedSender<FrameInput>, slots: Arc<Semaphore>) -> Self {
        Self { frames: Some(frames), slots, last_sequence: None }
    }

    /// Sends a frame; waits while the window is full. An outcome that arrives makes room, whether
    /// the application has taken it yet or not.
    ///
    /// # Errors
    /// [`Error::SequenceNotRising`] if its number is not above the last: the frame is not sent, the
    /// session continues. [`Error::SessionEnded`] if the session is over: [`Outcomes::next`] says
    /// why.
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
    exchange: Task,
}

impl Outcomes {
    pub(super) fn new(outcomes: mpsc::UnboundedReceiver<FrameOutcome>, exchange: Task) -> Self {
        Self { outcomes, exchange }
    }

    /// What the server said when the session was opened.
    pub(super) async fn opened(
        &mut self,
        opened: oneshot::Receiver<v1::SessionOpened>,
    ) -> Result<v1::SessionOpened, Error> {
        self.exchange.opened(opened).await
    }

    /// The outcome of the next frame, in the order of sending. None when the session was finished
    /// and every frame has had its outcome, and after an error.
    ///
    /// # Errors
    /// [`Error::Status`] if the server ended the session: ABORTED when another stream took it over,
    /// NOT_FOUND when its map was deleted. [`Error::SessionLost`] if the server stayed away, or
    /// asked to send a frame again, for too long. [`Error::SessionRewound`] if it came back with
    /// older data. Frames without an outcome may be durable all the same: a session that is opened
    /// again says so.
    pub async fn next(&mut self) -> Result<Option<FrameOutcome>, Error> {
        match self.outcomes.recv().await {
            Some(outcome) => Ok(Some(outcome)),
            None => self.exchange.ending().await.map(|()| None),
        }
    }
}

impl Drop for Outcomes {
    fn drop(&mut self) {
        self.exchange.abort();
    }
}
