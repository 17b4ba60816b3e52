//! What was lately asked for of earlier frames: a frame is compared with many, and a query for each would
//! take longer than all the rest.

use std::collections::{HashMap, VecDeque};
use std::hash::Hash;

use fabmap::observation::Observation;
use topomap::ids::FrameId;
use topomap::log::FrameEvent;
use topomap::metric::RelativePose;

use crate::storage::StoredFrame;

/// Something of some frames, the latest that were asked for.
#[derive(Debug)]
pub(crate) struct Recent<T, Key = FrameId> {
    most: usize,
    frames: HashMap<Key, T>,
    /// Oldest first.
    order: VecDeque<Key>,
}

/// What is on the disk of a frame: a kilobyte or two.
#[derive(Clone, Debug)]
pub(super) struct RecentFrame {
    pub(super) stored: StoredFrame,
    pub(super) observation: Observation,
    /// Where in its place it was taken.
    pub(super) at: Option<RelativePose>,
}

impl<T, Key: Copy + Eq + Hash> Recent<T, Key> {
    /// Of `most` frames at most.
    pub(crate) fn new(most: usize) -> Self {
        Self { most, frames: HashMap::new(), order: VecDeque::new() }
    }

    /// Gives their memory back.
    pub(super) fn forget(&mut self) {
        *self = Self::new(self.most);
    }

    pub(crate) fn get(&self, frame: Key) -> Option<&T> {
        self.frames.get(&frame)
    }

    pub(crate) fn keep(&mut self, frame: Key, value: T) {
        if self.frames.insert(frame, value).is_none() {
            self.order.push_back(frame);
        }
        if self.order.len() > self.most
            && let Some(oldest) = self.order.pop_front()
        {
            self.frames.remove(&oldest);
        }
    }
}

impl RecentFrame {
    pub(super) fn of(event: &FrameEvent, note: String) -> Self {
        let FrameEvent { session, sequence, stamp_ns, at, ref observation, .. } = *event;
        let stored = StoredFrame { session, sequence, stamp_ns, note };
        Self { stored, observation: observation.clone(), at }
    }
}
