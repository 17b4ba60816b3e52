//! A map's log, in memory.

use anyhow::Context;
use fabmap::observation::Observation;
use topomap::evidence::{ArchiveError, FrameArchive};
use topomap::ids::FrameId;
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::Mapper;
use topomap::merging::Layout;
use topomap::metric::RelativePose;

use crate::error::fault;

/// What a mapper in this process was told and has decided.
#[derive(Clone, Debug, Default)]
pub(crate) struct EventLog(pub Vec<MapEvent>);

impl EventLog {
    /// The frames, in order.
    pub(crate) fn frames(&self) -> impl Iterator<Item = &FrameEvent> {
        self.0.iter().filter_map(|event| match event {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => None,
            MapEvent::Frame(event) => Some(event.as_ref()),
        })
    }

    /// A frame by its position in the log, which is not its index in the sequence: opening the
    /// session took the first position.
    pub(crate) fn frame(&self, frame: FrameId) -> Option<&FrameEvent> {
        match self.0.get(usize::try_from(frame).ok()?)? {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => None,
            MapEvent::Frame(event) => Some(event),
        }
    }

    /// The index in the sequence of a frame: the sequence number that it was sent with.
    pub(crate) fn index(&self, frame: FrameId) -> Option<usize> {
        usize::try_from(self.frame(frame)?.sequence).ok()
    }
}

/// Folds events into a map, by the decisions that they tell.
pub(crate) fn fold_all(mapper: &mut Mapper, events: &[MapEvent]) -> anyhow::Result<()> {
    for (index, event) in events.iter().enumerate() {
        mapper.fold(event).map_err(fault).with_context(|| format!("frame {index}"))?;
    }
    Ok(())
}

/// A map as merging lays it out.
pub(crate) fn layout(mapper: &Mapper) -> Layout<'_> {
    let settings = mapper.settings();
    Layout { poses: mapper.poses(), noise: settings.odometry_noise, spacing: settings.place_spacing }
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
