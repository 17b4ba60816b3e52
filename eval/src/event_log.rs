//! A map's log, in memory.

use fabmap::observation::Observation;
use topomap::event::{FrameEvent, FrameId, MapEvent};
use topomap::mapper::{ArchiveError, FrameArchive};
use topomap::relative_pose::RelativePose;

/// What a mapper in this process was told and has decided.
#[derive(Clone, Debug, Default)]
pub struct EventLog(pub Vec<MapEvent>);

impl EventLog {
    /// The frames, in order.
    pub fn frames(&self) -> impl Iterator<Item = &FrameEvent> {
        self.0.iter().filter_map(|event| match event {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => None,
            MapEvent::Frame(event) => Some(event.as_ref()),
        })
    }

    /// A frame by its position in the log, which is not its index in the sequence: opening the
    /// session took the first position.
    #[must_use]
    pub fn frame(&self, frame: FrameId) -> Option<&FrameEvent> {
        match self.0.get(usize::try_from(frame).ok()?)? {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => None,
            MapEvent::Frame(event) => Some(event),
        }
    }
}

impl FrameArchive for EventLog {
    fn observation(&self, frame: FrameId) -> Result<Option<Observation>, ArchiveError> {
        match self.frame(frame) {
            Some(event) => Ok(Some(event.observation.clone())),
            None => Err(ArchiveError { frame, why: "it is not in the log".to_owned() }),
        }
    }

    fn at(&self, frame: FrameId) -> Result<Option<RelativePose>, ArchiveError> {
        Ok(self.frame(frame).and_then(|event| event.at))
    }
}
