//! Frames that wait for the server, the oldest making way for the newest.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use waypost_bags::Frame;

/// Bound of what waits, however many frames that is.
const MOST_BYTES: usize = 256 << 20;

/// A bounded queue between those who take frames from the robot and the one who sends them.
pub(crate) struct Outbox {
    waiting: Mutex<Waiting>,
    came: Notify,
}

#[derive(Default)]
struct Waiting {
    frames: VecDeque<Frame>,
    bytes: usize,
    /// 0 while no session is wanted.
    most_frames: usize,
}

impl Outbox {
    /// Takes nothing yet.
    pub(crate) fn new() -> Self {
        Self { waiting: Mutex::default(), came: Notify::new() }
    }

    /// Takes frames from now on; those that wait already have room.
    pub(crate) fn open(&self, most_frames: usize) {
        self.lock().most_frames = most_frames.max(1);
    }

    /// Takes none from now on. What waits already may still be taken out.
    pub(crate) fn shut(&self) {
        self.lock().most_frames = 0;
    }

    /// Forgets what waits, and says how many that were.
    pub(crate) fn clear(&self) -> u64 {
        let mut waiting = self.lock();
        waiting.bytes = 0;
        let count = waiting.frames.drain(..).count();
        u64::try_from(count).unwrap_or(u64::MAX)
    }

    /// Whether frames are taken.
    pub(crate) fn is_open(&self) -> bool {
        self.lock().most_frames > 0
    }

    /// Takes a frame if any are taken, and says how many it drove out.
    pub(crate) fn put(&self, frame: Frame) -> u64 {
        let mut dropped = 0;
        let mut waiting = self.lock();
        if waiting.most_frames == 0 {
            return 0;
        }
        waiting.bytes += frame.image.len();
        waiting.frames.push_back(frame);
        while waiting.frames.len() > waiting.most_frames || waiting.bytes > MOST_BYTES {
            let Some(oldest) = waiting.frames.pop_front() else { break };
            waiting.bytes -= oldest.image.len();
            dropped += 1;
        }
        drop(waiting);
        self.came.notify_one();
        dropped
    }

    /// The oldest frame, once there is one.
    pub(crate) async fn take(&self) -> Frame {
        loop {
            if let Some(frame) = self.pop() {
                return frame;
            }
            self.came.notified().await;
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.lock().frames.len()
    }

    fn pop(&self) -> Option<Frame> {
        let mut waiting = self.lock();
        let frame = waiting.frames.pop_front()?;
        waiting.bytes -= frame.image.len();
        Some(frame)
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(number: u64) -> Frame {
        Frame { number, stamp_ns: 1, image: vec![0; 10], pose: None }
    }

    #[tokio::test]
    async fn the_oldest_make_way_and_are_counted() {
        let outbox = Outbox::new();
        outbox.open(2);
        let dropped: u64 = (1..=5).map(|number| outbox.put(frame(number))).sum();
        assert_eq!((dropped, outbox.len()), (3, 2));
        assert_eq!([outbox.take().await.number, outbox.take().await.number], [4, 5]);
        assert_eq!(outbox.lock().bytes, 0);
    }

    #[tokio::test]
    async fn what_waits_is_taken_out_when_nothing_more_is_wanted() {
        let outbox = Outbox::new();
        assert_eq!((outbox.is_open(), outbox.put(frame(1)), outbox.len()), (false, 0, 0));
        outbox.open(2);
        assert_eq!(outbox.put(frame(2)), 0);
        outbox.shut();
        outbox.put(frame(3));
        assert_eq!((outbox.len(), outbox.take().await.number), (1, 2));
        outbox.open(2);
        outbox.put(frame(4));
        assert_eq!((outbox.clear(), outbox.len(), outbox.lock().bytes), (1, 0, 0));
    }

    #[tokio::test]
    async fn who_waits_is_woken() {
        let outbox = std::sync::Arc::new(Outbox::new());
        outbox.open(2);
        let taking = tokio::spawn({
            let outbox = outbox.clone();
            async move { outbox.take().await.number }
        });
        tokio::task::yield_now().await;
        outbox.put(frame(7));
        assert_eq!(taking.await.unwrap(), 7);
    }
}
