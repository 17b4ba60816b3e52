//! What robots measure by themselves goes into the log.

use topomap::log::MapEvent;
use topomap::mapper::{MapPose, Measurement};

use super::requests::MeasuredFrames;
use super::{CommitFailed, MapWriter};
use crate::error::ServiceError;
use crate::storage::LogEntry;

impl MapWriter {
    /// Decides, stores and applies; what was stored before changes nothing.
    pub(super) fn measure(
        &mut self,
        frames: &MeasuredFrames,
    ) -> Result<Result<Option<MapPose>, ServiceError>, CommitFailed> {
        let MeasuredFrames { later, before, earlier, pose } = frames;
        let measurement = Measurement { later, before: before.as_ref(), earlier, pose: *pose };
        let event = match self.mapper.measure(&measurement) {
            Ok(event) => event,
            Err(error) => return Ok(Err(ServiceError::precondition(error))),
        };
        if !self.mapper.has_measured(&event) {
            if let Err(damaged) = self.storage.check_sound(self.map.id) {
                return Ok(Err(damaged.into()));
            }
            let position = event.position;
            let event = MapEvent::Measured(Box::new(event));
            let entry = LogEntry { position, event, media: Vec::new(), note: String::new() };
            self.take_in(&entry)?;
        }
        let session = self.mapper.map().session(later.session);
        Ok(Ok(session.and_then(|session| self.mapper.map_pose(session))))
    }
}
