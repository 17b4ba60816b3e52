//! The log itself, as it answers for earlier frames.

use fabmap::observation::Observation;
use topomap::event::{FrameId, MapEvent};
use topomap::mapper::{ArchiveError, FrameArchive};
use topomap::relative_pose::RelativePose;

pub(crate) struct LogArchive<'a>(pub(crate) &'a [MapEvent]);

impl FrameArchive for LogArchive<'_> {
    fn observation(&self, frame: FrameId) -> Result<Option<Observation>, ArchiveError> {
        match &self.0[frame as usize] {
            MapEvent::Frame(event) => Ok(Some(event.observation.clone())),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => {
                Err(ArchiveError { frame, why: "not a frame".to_owned() })
            }
        }
    }

    fn at(&self, frame: FrameId) -> Result<Option<RelativePose>, ArchiveError> {
        match &self.0[frame as usize] {
            MapEvent::Frame(event) => Ok(event.at),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => {
                Err(ArchiveError { frame, why: "not a frame".to_owned() })
            }
        }
    }
}
