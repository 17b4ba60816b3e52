//! Which frame of a stream may come next.

use std::collections::BTreeSet;
use std::time::Instant;

use crate::error::ServiceError;
use crate::open_map::MapHandle;

/// Keeps frames from overtaking one that must be sent again: a later number, once committed, would
/// shut it out for good.
#[derive(Debug)]
pub(super) struct Order {
    /// The map's writer that this stream submits to. A new one is taken only to resend.
    pub(super) map: MapHandle,
    /// Handed over and not yet answered.
    pub(super) submitted: BTreeSet<u64>,
    /// The first frame that was refused only for now: it must come again before any later one.
    refused: Option<u64>,
    /// When it was asked to come, if that was said: those behind it are told the same.
    resend_at: Option<Instant>,
    /// It has come again and is being prepared, so that those behind it may be, too.
    coming_again: bool,
    pub(super) last_committed: Option<u64>,
    /// How often a new writer was taken: what an earlier one left behind says nothing about order.
    pub(super) generation: u64,
}

impl Order {
    pub(super) fn new(map: MapHandle, last_committed: Option<u64>) -> Self {
        Self {
            map,
            submitted: BTreeSet::new(),
            refused: None,
            resend_at: None,
            coming_again: false,
            last_committed,
            generation: 0,
        }
    }

    /// Takes a writer that nothing has been handed over to.
    pub(super) fn begin_anew(&mut self, map: MapHandle) {
        self.map = map;
        (self.refused, self.resend_at, self.coming_again) = (None, None, false);
        self.submitted.clear();
        self.generation += 1;
    }

    /// Notes a frame that goes to the writer; returns the writer's generation.
    pub(super) fn hand_over(&mut self, sequence: u64) -> u64 {
        self.submitted.insert(sequence);
        self.generation
    }

    /// The frame that may come next, if not any: the one refused, or an earlier one while it is still out.
    pub(super) fn resend_from(&self) -> Option<u64> {
        let refused = self.refused?;
        Some(self.submitted.first().map_or(refused, |&first| first.min(refused)))
    }

    /// Notes that a frame has come. If it is the turn of an earlier one, gives that.
    pub(super) fn comes_before_its_turn(&mut self, sequence: u64) -> Option<u64> {
        let resend_from = self.resend_from()?;
        self.coming_again |= sequence == resend_from;
        (sequence > resend_from && !self.coming_again).then_some(resend_from)
    }

    /// From now on only `sequence`, or an earlier frame that is still out, may come next.
    pub(super) fn wait_for(&mut self, sequence: u64, generation: u64, error: &ServiceError) {
        if generation != self.generation {
            return;
        }
        if let Some(retry_after) = error.retry_after() {
            self.resend_at = self.resend_at.max(Some(Instant::now() + retry_after));
        }
        self.refused = Some(self.refused.map_or(sequence, |before| before.min(sequence)));
        self.coming_again = false;
    }

    /// A frame that came again is not to come any more.
    pub(super) fn give_up(&mut self, sequence: u64) {
        if self.refused == Some(sequence) {
            (self.refused, self.resend_at, self.coming_again) = (None, None, false);
        }
    }

    /// Why a frame behind `resend_from` is refused.
    pub(super) fn send_first(&self, resend_from: u64) -> ServiceError {
        let message = format!("frame {resend_from} must be sent again first, then this one");
        let left = self.resend_at.and_then(|at| at.checked_duration_since(Instant::now()));
        ServiceError::Unavailable { message, retry_after: left }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::sync::mpsc;

    use super::*;
    use crate::storage::MapEdition;

    fn order() -> Order {
        Order::new(MapHandle::new(MapEdition { map: 1, edition: 0 }, mpsc::channel(1).0), None)
    }

    fn for_now() -> ServiceError {
        ServiceError::overloaded(Duration::from_secs(1))
    }

    #[test]
    fn a_frame_that_is_answered_is_not_waited_for() {
        let mut order = order();
        let generation = order.hand_over(1);
        order.wait_for(2, generation, &for_now());
        // Frame 1 may still fail.
        assert_eq!(order.comes_before_its_turn(3), Some(1));
        order.submitted.remove(&1);
        assert_eq!(order.comes_before_its_turn(3), Some(2));
        assert_eq!(order.comes_before_its_turn(2), None);
    }

    #[test]
    fn those_behind_may_come_as_soon_as_the_frame_has_come_again() {
        let mut order = order();
        order.wait_for(2, 0, &for_now());
        assert_eq!((order.comes_before_its_turn(3), order.comes_before_its_turn(2)), (Some(2), None));
        assert_eq!(order.comes_before_its_turn(3), None);
        // Refused once more.
        order.wait_for(2, 0, &for_now());
        assert_eq!(order.comes_before_its_turn(3), Some(2));
    }

    #[test]
    fn a_frame_that_is_refused_for_good_is_not_waited_for() {
        let mut order = order();
        order.wait_for(2, 0, &for_now());
        order.give_up(3);
        assert_eq!(order.comes_before_its_turn(3), Some(2));
        order.give_up(2);
        assert_eq!(order.comes_before_its_turn(3), None);
    }

    #[test]
    fn frames_behind_are_told_when_the_frame_was_asked_to_come() {
        let mut order = order();
        order.wait_for(2, 0, &for_now());
        let ServiceError::Unavailable { retry_after: Some(left), .. } = order.send_first(2) else {
            panic!("no time was said");
        };
        assert!(left <= Duration::from_secs(1) && left > Duration::ZERO, "{left:?}");
    }
}
