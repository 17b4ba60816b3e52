//! When to try again, and when to give up.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::Instant;

use crate::error::Error;

/// How to reconnect: after delays that double. Each is shortened at random by up to half, so that
/// robots do not all come back at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reconnection {
    /// Before the first attempt.
    pub first_delay: Duration,
    /// Delays grow no further than this.
    pub longest_delay: Duration,
    /// Time without progress after which the stream is given up.
    pub give_up_after: Duration,
}

impl Default for Reconnection {
    /// 0.1 s, doubling up to 5 s, for 60 s.
    fn default() -> Self {
        Self {
            first_delay: Duration::from_millis(100),
            longest_delay: Duration::from_secs(5),
            give_up_after: Duration::from_secs(60),
        }
    }
}

/// Whoever waits for longer does not mean to give up.
const A_YEAR: Duration = Duration::from_secs(365 * 24 * 3600);

impl Reconnection {
    /// For how long another attempt is made, as a message says it.
    pub(crate) fn patience(&self) -> String {
        if self.give_up_after > A_YEAR {
            "until it is back".to_owned()
        } else {
            format!("for {} s", self.give_up_after.as_secs())
        }
    }
}

/// Time and delays since the last progress.
#[derive(Debug)]
pub(crate) struct Backoff {
    settings: Reconnection,
    jitter: ChaCha8Rng,
    delay: Duration,
    trouble_since: Option<Instant>,
}

impl Backoff {
    pub(crate) fn new(settings: Reconnection) -> Self {
        Self::with_seed(settings, random_seed())
    }

    fn with_seed(settings: Reconnection, seed: u64) -> Self {
        let jitter = ChaCha8Rng::seed_from_u64(seed);
        Self { delay: settings.first_delay, settings, jitter, trouble_since: None }
    }

    /// The delay before the next attempt; none if it is time to give up. The last attempt falls on
    /// the moment of giving up.
    pub(crate) fn next_delay(&mut self, now: Instant) -> Option<Duration> {
        let waited = now - *self.trouble_since.get_or_insert(now);
        let left = self.settings.give_up_after.checked_sub(waited).filter(|left| !left.is_zero())?;
        let delay = self.delay.min(self.settings.longest_delay);
        self.delay = delay.saturating_mul(2);
        Some(delay.mul_f64(self.jitter.random_range(0.5..=1.0)).min(left))
    }

    /// As [`next_delay`](Self::next_delay) from now.
    ///
    /// # Errors
    /// [`Error::SessionLost`] if it is time to give up.
    pub(crate) fn delay_or_give_up(
        &mut self,
        unacknowledged: usize,
        reason: &str,
    ) -> Result<Duration, Error> {
        let now = Instant::now();
        self.next_delay(now).ok_or_else(|| Error::SessionLost {
            unacknowledged,
            waited: self.waited(now),
            reason: reason.to_owned(),
        })
    }

    /// Whether there was a failure since the last progress.
    pub(crate) fn is_in_trouble(&self) -> bool {
        self.trouble_since.is_some()
    }

    /// The server answered: the next failure starts over with the first delay.
    pub(crate) fn progress(&mut self) {
        self.delay = self.settings.first_delay;
        self.trouble_since = None;
    }

    /// Time since the first failure without progress afterwards.
    pub(crate) fn waited(&self, now: Instant) -> Duration {
        self.trouble_since.map_or(Duration::ZERO, |since| now - since)
    }
}

/// A random number, different in each call.
pub(crate) fn random_seed() -> u64 {
    RandomState::new().hash_one(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn backoff(seed: u64) -> Backoff {
        Backoff::with_seed(Reconnection::default(), seed)
    }

    /// All delays until it gives up, if every attempt fails at once.
    fn delays(mut backoff: Backoff) -> Vec<Duration> {
        let mut now = Instant::now();
        std::iter::from_fn(|| {
            let delay = backoff.next_delay(now)?;
            now += delay;
            Some(delay)
        })
        .collect()
    }

    #[test]
    fn delays_double_up_to_the_longest_and_add_up_to_the_time_of_giving_up() {
        let settings = Reconnection::default();
        let delays = delays(backoff(1));
        let mut full = settings.first_delay;
        for delay in &delays[..delays.len() - 1] {
            assert!(*delay >= full / 2 && *delay <= full, "{delay:?} of {full:?}");
            full = (full * 2).min(settings.longest_delay);
        }
        assert_eq!(full, settings.longest_delay);
        assert_eq!(delays.iter().sum::<Duration>(), settings.give_up_after);
    }

    #[test]
    fn who_never_gives_up_is_told_no_number() {
        let settings = Reconnection::default();
        assert_eq!(settings.patience(), "for 60 s");
        let never = Reconnection { give_up_after: 10 * A_YEAR, ..settings };
        assert_eq!(never.patience(), "until it is back");
    }

    #[test]
    fn the_seed_decides_the_jitter() {
        assert_eq!(delays(backoff(1)), delays(backoff(1)));
        assert_ne!(delays(backoff(1)), delays(backoff(2)));
    }

    #[test]
    fn progress_starts_over() {
        let mut backoff = backoff(3);
        let start = Instant::now();
        let later = start + Duration::from_secs(59);
        assert!(backoff.next_delay(start).is_some());
        assert_eq!(backoff.waited(later), Duration::from_secs(59));
        backoff.progress();
        assert_eq!(backoff.waited(later), Duration::ZERO);
        let delay = backoff.next_delay(later).unwrap();
        assert!(delay <= Reconnection::default().first_delay);
        assert!(backoff.next_delay(later + Duration::from_secs(59)).is_some());
        assert_eq!(backoff.next_delay(later + Duration::from_secs(60)), None);
    }
}
