//! What robots measure by themselves.

use topomap::log::FrameEvent;
use topomap::mapper::MapPose;
use topomap::metric::RelativePose;

use super::frames::{Frames, no_such_frame, no_such_session};
use crate::error::ServiceError;
use crate::names::frame_in;
use crate::open_map::MeasuredFrames;
use crate::storage::MapRow;

/// Takes in what robots measure. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Measurements {
    pub(super) frames: Frames,
}

impl Measurements {
    /// Takes in where a robot was at a frame, seen from an earlier one; where its session's robot is on the map then.
    pub(crate) async fn add(
        &self,
        later: &str,
        earlier: &str,
        pose: RelativePose,
    ) -> Result<Option<MapPose>, ServiceError> {
        let (map, _, _) = frame_in(later)?;
        let (other, _, _) = frame_in(earlier)?;
        if map != other {
            return Err(ServiceError::invalid(format_args!(
                "{later} is of the map {map}, {earlier} of {other}; a measurement is between frames of one map"
            )));
        }
        let row = self.frames.open_maps.row(map).await?;
        let writer = self.frames.open_maps.open(map).await?;
        let later_frame = self.logged_frame(&row, later).await?;
        let words = self.frames.vocabulary_len(&row).await?;
        let before = self.frames.storage.frame_before(row.id, &later_frame, words).await?;
        let earlier = self.logged_frame(&row, earlier).await?;
        writer.measure(MeasuredFrames { later: later_frame, before, earlier, pose }).await
    }

    async fn logged_frame(&self, map: &MapRow, name: &str) -> Result<FrameEvent, ServiceError> {
        let (_, session, sequence) = frame_in(name)?;
        let number = self.frames.storage.session_number(map.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(&map.name, session))?;
        let words = self.frames.vocabulary_len(map).await?;
        let row = self.frames.storage.frame_of_sequence(map.id, number, sequence, words).await?;
        Ok(row.ok_or_else(|| no_such_frame(&map.name, session, sequence))?.event)
    }
}
