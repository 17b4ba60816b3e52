//! What is worth a line in the log, but not one for each time.

use std::time::{Duration, Instant};

/// A complaint is logged once in this time, however often there is reason for it.
const INTERVAL: Duration = Duration::from_secs(10);

/// When a complaint was last logged.
#[derive(Debug, Default)]
pub(super) struct Complaint {
    last: Option<Instant>,
    untold: u64,
}

impl Complaint {
    /// There is reason for it once more. If it is to be logged now: how often there was since the last time that it was.
    pub(super) fn count(&mut self) -> Option<u64> {
        if self.last.is_some_and(|last| last.elapsed() < INTERVAL) {
            self.untold += 1;
            return None;
        }
        self.last = Some(Instant::now());
        Some(std::mem::take(&mut self.untold))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_complaint_is_told_once_and_then_says_how_often_it_was_not() {
        let mut complaint = Complaint::default();
        assert_eq!(complaint.count(), Some(0));
        assert_eq!((complaint.count(), complaint.count()), (None, None));
        complaint.last = complaint.last.and_then(|last| last.checked_sub(INTERVAL));
        assert_eq!(complaint.count(), Some(2));
        assert_eq!(complaint.count(), None);
    }
}
