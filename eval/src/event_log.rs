//! A map's log, in memory.

use anyhow::Context;
use topomap::ids::FrameId;
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::Mapper;
use topomap::merging::Layout;

use crate::error::fault;

/// What a mapper in this process was told and has decided.
#[derive(Clone, Debug, Default)]
pub(crate) struct EventLog(pub Vec<MapEvent>);

impl EventLog {
    /// The frames, in order.
    pub(crate) fn frames(&self) -> impl Iterator<Item = &FrameEvent> {
        self.0.iter().filter_map(|event| match event {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
            MapEvent::Frame(event) => Some(event.as_ref()),
        })
    }

    /// A frame by its position in the log, which is not its index in the sequence: opening the
    /// session took the first position.
    pub(crate) fn frame(&self, frame: FrameId) -> Option<&FrameEvent> {
        match self.0.get(usize::try_from(frame).ok()?)? {
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
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
