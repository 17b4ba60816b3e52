//! One frame by itself, of a robot that holds no stream open.

use std::convert::Infallible;

use futures::stream::{self, StreamExt};

use super::{Frame, FrameOutcome, Robot, Sessions};
use crate::error::ServiceError;
use crate::open_map::SessionMode;
use crate::open_map::answers::FrameAnswer;

impl Sessions {
    /// What becomes of one frame of a session, which begins with its first one. A stream that the session has open ends,
    /// as it does when the robot opens another.
    ///
    /// # Errors
    /// As for a frame of a stream.
    pub(crate) async fn put_frame(
        &self,
        map: &str,
        session: &str,
        frame: Frame,
        robot: Robot<'_>,
    ) -> Result<FrameAnswer, ServiceError> {
        let stream = self.open(map, session, SessionMode::Map, None, robot).await?;
        let outcomes = stream.run(stream::iter([Ok::<_, Infallible>(Ok(frame))]));
        match Box::pin(outcomes).next().await {
            Some(Ok(FrameOutcome::Answered(answer))) => Ok(*answer),
            Some(Ok(FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error))) => Err(error),
            Some(Err(never)) => match never {},
            None => Err(ServiceError::internal("nothing became of a frame")),
        }
    }
}
