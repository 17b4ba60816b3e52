//! Frames that were lately decided or compared with: a frame is compared with many, and a query for each
//! would take longer than all the rest.

use std::collections::{HashMap, VecDeque};

use fabmap::observation::Observation;
use topomap::event::{FrameEvent, FrameId};

use crate::storage::StoredFrame;

/// Most frames that are kept, of a kilobyte or two each.
const MOST: usize = 4096;

/// What is on the disk of some frames, the latest that were asked for.
#[derive(Debug, Default)]
pub(super) struct RecentFrames {
    frames: HashMap<FrameId, RecentFrame>,
    /// Oldest first.
    order: VecDeque<FrameId>,
}

#[derive(Clone, Debug)]
pub(super) struct RecentFrame {
    pub(super) stored: StoredFrame,
    pub(super) observation: Observation,
}

impl RecentFrames {
    pub(super) fn get(&self, frame: FrameId) -> Option<&RecentFrame> {
        self.frames.get(&frame)
    }

    /// Takes in a frame that is on the disk.
    pub(super) fn keep(&mut self, event: &FrameEvent) {
        let FrameEvent { frame, session, sequence, stamp_ns, ref observation, .. } = *event;
        let stored = StoredFrame { session, sequence, stamp_ns };
        let recent = RecentFrame { stored, observation: observation.clone() };
        if self.frames.insert(frame, recent).is_none() {
            self.order.push_back(frame);
        }
        if self.order.len() > MOST
            && let Some(oldest) = self.order.pop_front()
        {
            self.frames.remove(&oldest);
        }
    }
}
