//! A stream of frames, from what a robot sends to what becomes of it.

use std::sync::Arc;

use futures::FutureExt;
use futures::stream::{self, Stream, StreamExt};

use super::{Frame, FrameOutcome, SessionStream};
use crate::error::ServiceError;

/// How many frames are under way at a time, so that one does not wait for all before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Windows {
    /// Frames that are turned into words side by side.
    pub(crate) prepared: usize,
    /// Frames that wait for their commit.
    pub(crate) submitted: usize,
}

/// Of one robot's stream: few, for each frame may be an image of several mebibytes.
const OF_A_ROBOT: Windows = Windows { prepared: 2, submitted: 8 };

/// A frame that cannot be taken, and why.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RefusedFrame {
    pub(crate) sequence: u64,
    pub(crate) error: ServiceError,
}

/// A frame as it came in.
pub(crate) type ReceivedFrame = Result<Frame, RefusedFrame>;

impl SessionStream {
    /// What becomes of each frame, in the order of `frames`; the last outcome says why the session is over, if it
    /// ends before them. An error of `frames` is passed on in its place.
    pub(crate) fn run<E: Send + 'static>(
        self,
        frames: impl Stream<Item = Result<ReceivedFrame, E>> + Send + 'static,
    ) -> impl Stream<Item = Result<FrameOutcome, E>> + Send {
        let session = Arc::new(self);
        let sending = session.clone();
        let counting = session.clone();
        let watching = session;
        let frames = frames.map(move |frame| Ok((sending.clone(), frame?)));
        let outcomes = run(frames, OF_A_ROBOT).inspect(move |outcome| {
            if let Ok(outcome) = outcome {
                counting.count(outcome);
            }
        });
        let over = async move { watching.over().await };
        stream::unfold(Some((outcomes.boxed(), over.boxed())), |state| async {
            let (mut outcomes, mut over) = state?;
            tokio::select! {
                // What was answered before the end is still said.
                biased;
                outcome = outcomes.next() => outcome.map(|outcome| (outcome, Some((outcomes, over)))),
                error = &mut over => Some((Ok(FrameOutcome::Ended(error)), None)),
            }
        })
    }
}

/// The same for frames of several sessions, each with its own; they are not watched for their end.
pub(in crate::service) fn run<E: Send>(
    frames: impl Stream<Item = Result<(Arc<SessionStream>, ReceivedFrame), E>> + Send,
    windows: Windows,
) -> impl Stream<Item = Result<FrameOutcome, E>> + Send {
    frames
        .map(|frame| async {
            let (session, frame) = frame?;
            let prepared = session.prepare(frame).await;
            Ok::<_, E>((session, prepared))
        })
        .buffered(windows.prepared)
        .then(|prepared| async {
            let (session, prepared) = prepared?;
            let pending = session.submit(prepared).await;
            Ok::<_, E>((session, pending))
        })
        .map(|submitted| async {
            let (session, pending) = submitted?;
            Ok(session.outcome(pending).await)
        })
        .buffered(windows.submitted)
}
