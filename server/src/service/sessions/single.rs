//! One frame by itself, of a robot that holds no stream open.

use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

use futures::stream::{self, StreamExt};
use tokio::sync::OwnedMutexGuard;
use topomap::log::MapEvent;

use super::{Frame, FrameOutcome, Robot, Sessions};
use crate::error::ServiceError;
use crate::ingest::content::Words;
use crate::map_settings::Keep;
use crate::names::{map_in, session_name};
use crate::open_map::SessionMode;
use crate::open_map::answers::FrameAnswer;
use crate::storage::MapRow;

/// Frames of one session take turns, in the order in which they came. Cheap to clone.
#[derive(Clone, Debug, Default)]
pub(in crate::service) struct Turns(Arc<Mutex<HashMap<String, Weak<tokio::sync::Mutex<()>>>>>);

impl Turns {
    async fn take(&self, session: &str) -> OwnedMutexGuard<()> {
        let turn = {
            let mut turns = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            turns.retain(|_, turn| turn.strong_count() > 0);
            turns.get(session).and_then(Weak::upgrade).unwrap_or_else(|| {
                let turn = Arc::default();
                turns.insert(session.to_owned(), Arc::downgrade(&turn));
                turn
            })
        };
        turn.lock_owned().await
    }
}

impl Sessions {
    /// What becomes of one frame of a session, which begins with its first one. A stream that the session has open ends,
    /// as it does when the robot opens another.
    ///
    /// # Errors
    /// As for a frame of a stream; FAILED_PRECONDITION if another frame has its number.
    pub(crate) async fn put_frame(
        &self,
        map: &str,
        session: &str,
        frame: Frame,
        robot: Robot<'_>,
    ) -> Result<FrameAnswer, ServiceError> {
        let _turn = self.turns.take(&session_name(map, session)).await;
        let row = self.open_maps.row(map_in(map)?).await?;
        if self.storage.session_number(row.id, session).await?.is_none() {
            self.check_first(&row, &frame, &robot).await?;
        }
        let Frame { sequence, stamp_ns, .. } = frame;
        let mut stream = self.open(map, session, SessionMode::Map, None, robot).await?;
        (stream.shown, stream.in_line) = (None, None);
        let outcomes = stream.run(stream::iter([Ok::<_, Infallible>(Ok(frame))]));
        match Box::pin(outcomes).next().await {
            Some(Ok(FrameOutcome::Answered(answer))) => {
                // It was there already, or is another.
                if answer.timings.is_none() {
                    self.check_same(&row, session, sequence, stamp_ns).await?;
                }
                Ok(*answer)
            }
            Some(Ok(FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error))) => Err(error),
            Some(Err(never)) => match never {},
            None => Err(ServiceError::internal("nothing became of a frame")),
        }
    }

    /// Refuses a first frame that would be refused in its session: that is not to be there without one.
    async fn check_first(&self, row: &MapRow, frame: &Frame, robot: &Robot<'_>) -> Result<(), ServiceError> {
        frame.check()?;
        let model = self.models.get(&row.model).await?;
        let words = Words::declared(robot.words_hash, &model)?;
        let token = robot.opener.as_ref().and_then(|opener| opener.token.as_deref());
        let turn = self.storage.quotas().frame(token, None, Instant::now())?;
        let observed =
            self.extraction.observe(model, frame.content.clone(), words, Keep::Words, None, None).await;
        match observed {
            // The turn is given back: the frame is counted once, where it is taken in.
            Ok(_) => Ok(()),
            Err(error) => {
                if !error.is_for_now() {
                    turn.spend();
                }
                Err(error)
            }
        }
    }

    /// Refuses another frame under a number that is taken. Its stamp tells: what it shows is not kept by every map.
    async fn check_same(
        &self,
        row: &MapRow,
        session: &str,
        sequence: u64,
        stamp_ns: i64,
    ) -> Result<(), ServiceError> {
        let words = self.models.get(&row.model).await?.model.vocabulary().len();
        let Some(number) = self.storage.session_number(row.id, session).await? else { return Ok(()) };
        let event = self.storage.event_of_sequence(row.id, number, sequence, words).await?;
        match event {
            Some(MapEvent::Frame(there)) if there.stamp_ns != stamp_ns => {
                Err(ServiceError::precondition(format_args!(
                    "frame {sequence} of the session {session} is there already, taken at {} ns, and this one at {stamp_ns} ns; \
                     number frames upwards, or begin another session",
                    there.stamp_ns
                )))
            }
            Some(_) | None => Ok(()),
        }
    }
}
