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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_kept_until_all_are_forgotten() {
        let mut recent = Recent::new(2);
        for frame in 1..=3 {
            recent.keep(frame, frame * 10);
        }
        assert_eq!([1, 2, 3].map(|frame| recent.get(frame).copied()), [None, Some(20), Some(30)]);
        recent.forget();
        assert_eq!([1, 2, 3].map(|frame| recent.get(frame).copied()), [None; 3]);
        for frame in 4..=6 {
            recent.keep(frame, frame * 10);
        }
        assert_eq!([4, 5, 6].map(|frame| recent.get(frame).copied()), [None, Some(50), Some(60)]);
    }
}
