//! What robots measure by themselves.

use std::sync::Arc;

use topomap::event::FrameEvent;
use topomap::mapper::MapPose;
use topomap::relative_pose::RelativePose;

use super::Service;
use super::frames::{no_such_frame, no_such_session};
use super::map_writer::MeasuredFrames;
use super::names::frame_in;
use crate::error::ServiceError;
use crate::storage::MapRow;

impl Service {
    /// Takes in where a robot was at a frame, seen from an earlier one; where its session's robot is on the map then.
    pub(crate) async fn measure_closure(
        self: &Arc<Self>,
        later: &str,
        earlier: &str,
        pose: RelativePose,
    ) -> Result<Option<MapPose>, ServiceError> {
        let ((map, _, _), (other, _, _)) = (frame_in(later)?, frame_in(earlier)?);
        if map != other {
            return Err(ServiceError::invalid(format_args!(
                "{later} is of the map {map}, {earlier} of {other}; a measurement is between frames of one map"
            )));
        }
        let row = self.map_row(map).await?;
        let writer = self.open_map(map).await?;
        let later_frame = self.logged_frame(&row, later).await?;
        let words = self.vocabulary_len(&row).await?;
        let before = self.storage.frame_before(row.id, &later_frame, words).await?;
        let earlier = self.logged_frame(&row, earlier).await?;
        writer.measure(MeasuredFrames { later: later_frame, before, earlier, pose }).await
    }

    async fn logged_frame(&self, map: &MapRow, name: &str) -> Result<FrameEvent, ServiceError> {
        let (_, session, sequence) = frame_in(name)?;
        let number = self.storage.session_number(map.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(&map.name, session))?;
        let words = self.vocabulary_len(map).await?;
        let row = self.storage.frame_of_sequence(map.id, number, sequence, words).await?;
        Ok(row.ok_or_else(|| no_such_frame(&map.name, session, sequence))?.event)
    }
}
