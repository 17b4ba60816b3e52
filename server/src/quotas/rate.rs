//! Frames a second: what a token may send over all its streams.
//!
//! A stream that is refused gets a place in line, and the time when it comes up. Without that, one stream that asks at the
//! right moment each time would have the whole rate, and another of the same token nothing.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How late a stream may come for its turn.
const GRACE: Duration = Duration::from_secs(1);

/// Nobody is asked to come sooner.
const MIN_RETRY: Duration = Duration::from_millis(20);

/// So little is missing that it is the rounding of times.
const ROUNDING: f64 = 1e-6;

/// A bucket that fills with so many frames a second, and holds those of one.
#[derive(Debug)]
pub(super) struct Rate {
    per_second: f64,
    /// Frames that may come at once.
    saved: f64,
    as_of: Instant,
    /// Streams that were refused, in the order of their turns.
    in_line: VecDeque<Turn>,
}

#[derive(Debug)]
struct Turn {
    stream: u64,
    due: Instant,
}

impl Rate {
    pub(super) fn new(per_second: f64, now: Instant) -> Self {
        Self { per_second, saved: most_saved(per_second), as_of: now, in_line: VecDeque::new() }
    }

    pub(super) fn per_second(&self) -> f64 {
        self.per_second
    }

    /// Takes a frame of a stream, or says how long to wait.
    pub(super) fn take(&mut self, stream: Option<u64>, now: Instant) -> Result<(), Duration> {
        let since = now.saturating_duration_since(self.as_of).as_secs_f64();
        self.saved = (self.saved + since * self.per_second).min(most_saved(self.per_second));
        self.as_of = self.as_of.max(now);
        self.in_line.retain(|turn| now < turn.due + GRACE);
        let own = self.in_line.iter().position(|turn| Some(turn.stream) == stream);
        // Each of those before it has one of what is saved.
        let ahead = own.unwrap_or(self.in_line.len()) as f64;
        let missing = ahead + 1.0 - self.saved;
        if missing <= ROUNDING {
            own.and_then(|own| self.in_line.remove(own));
            self.saved = (self.saved - 1.0).max(0.0);
            return Ok(());
        }
        let wait = Duration::from_secs_f64(missing / self.per_second).max(MIN_RETRY);
        match own.and_then(|own| self.in_line.get_mut(own)) {
            // One that asks early hears the same time.
            Some(turn) if turn.due > now => Err((turn.due - now).max(MIN_RETRY)),
            Some(turn) => {
                turn.due = now + wait;
                Err(wait)
            }
            None => {
                self.in_line.extend(stream.map(|stream| Turn { stream, due: now + wait }));
                Err(wait)
            }
        }
    }

    /// A frame that was taken was not looked at after all.
    pub(super) fn give_back(&mut self) {
        self.saved = (self.saved + 1.0).min(most_saved(self.per_second));
    }
}

/// Those of one second, and always one.
fn most_saved(per_second: f64) -> f64 {
    per_second.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many frames each of `streams` gets in `seconds`, that come as soon as they are told to.
    fn taken(per_second: f64, streams: &[u64], seconds: u64) -> Vec<u32> {
        let start = Instant::now();
        let mut rate = Rate::new(per_second, start);
        let mut next: Vec<(Instant, usize, u32)> =
            streams.iter().enumerate().map(|(index, _)| (start, index, 0)).collect();
        loop {
            // Ties go to the first, which would starve the others without a line.
            let (now, index, taken) = next.iter().min().copied().unwrap();
            if now >= start + Duration::from_secs(seconds) {
                next.sort_by_key(|(_, index, _)| *index);
                return next.into_iter().map(|(_, _, taken)| taken).collect();
            }
            let entry = next.iter_mut().find(|(_, other, _)| *other == index).unwrap();
            *entry = match rate.take(Some(streams[index]), now) {
                Ok(()) => (now + Duration::from_micros(10), index, taken + 1),
                Err(wait) => (now + wait, index, taken),
            };
        }
    }

    #[test]
    fn a_stream_gets_the_rate_and_what_one_second_saved() {
        // The last of them comes up as the time ends.
        assert_eq!(taken(5.0, &[7], 10), [5 + 50 - 1]);
        assert_eq!(taken(0.5, &[7], 20), [1 + 10 - 1]);
    }

    #[test]
    fn streams_of_one_token_share_its_rate_evenly() {
        let taken = taken(6.0, &[1, 2, 3], 30);
        let (least, most) = (taken.iter().min().unwrap(), taken.iter().max().unwrap());
        let sum: u32 = taken.iter().sum();
        assert!(most - least <= 7 && (180..=186).contains(&sum), "{taken:?}");
    }

    #[test]
    fn one_that_does_not_come_back_holds_up_the_others_for_a_second() {
        let start = Instant::now();
        let mut rate = Rate::new(1.0, start);
        assert_eq!(rate.take(Some(1), start), Ok(()));
        let wait = rate.take(Some(2), start).unwrap_err();
        assert_eq!(wait, Duration::from_secs(1));
        // In its turn it would be first.
        assert!(rate.take(Some(1), start + wait).is_err());
        assert_eq!(rate.take(Some(1), start + wait + GRACE), Ok(()));
    }

    #[test]
    fn who_asks_early_hears_the_same_time_and_who_has_no_stream_keeps_nobody_out() {
        let start = Instant::now();
        let mut rate = Rate::new(2.0, start);
        assert_eq!([rate.take(None, start), rate.take(None, start)], [Ok(()), Ok(())]);
        assert!(rate.take(None, start).is_err());
        let wait = rate.take(Some(1), start).unwrap_err();
        assert_eq!(wait, Duration::from_millis(500));
        let early = Duration::from_millis(200);
        assert_eq!(rate.take(Some(1), start + early), Err(wait - early));
        assert!(rate.take(None, start + wait).is_err());
        assert_eq!(rate.take(Some(1), start + wait), Ok(()));
        rate.give_back();
        assert_eq!(rate.take(None, start + wait), Ok(()));
    }
}
