//! When to try again, and when to give up.

use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tokio::time::Instant;

/// How a broken connection is mended: after delays that double, each shortened at random by up to
/// half so that robots do not all come back at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reconnection {
    /// Before the first attempt.
    pub first_delay: Duration,
    /// Delays grow no further than this.
    pub longest_delay: Duration,
    /// Time without any progress after which the session is given up.
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

/// Counts attempts and time since the last progress.
#[derive(Debug)]
pub(crate) struct Backoff {
    settings: Reconnection,
    jitter: ChaCha8Rng,
    delay: Duration,
    trouble_since: Option<Instant>,
}

impl Backoff {
    pub(crate) fn new(settings: Reconnection, jitter: ChaCha8Rng) -> Self {
        Self { delay: settings.first_delay, settings, jitter, trouble_since: None }
    }

    /// How long to wait before the next attempt; none if it is time to give up. The last attempt
    /// falls on the moment of giving up.
    pub(crate) fn next_delay(&mut self, now: Instant) -> Option<Duration> {
        let waited = now - *self.trouble_since.get_or_insert(now);
        let left = self.settings.give_up_after.checked_sub(waited).filter(|left| !left.is_zero())?;
        let delay = self.delay.min(self.settings.longest_delay);
        self.delay = delay.saturating_mul(2);
        Some(delay.mul_f64(self.jitter.random_range(0.5..=1.0)).min(left))
    }

    /// The server did what was asked: the next trouble is a new one.
    pub(crate) fn progress(&mut self) {
        self.delay = self.settings.first_delay;
        self.trouble_since = None;
    }

    /// Time since the present trouble began.
    pub(crate) fn waited(&self, now: Instant) -> Duration {
        self.trouble_since.map_or(Duration::ZERO, |since| now - since)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn backoff(seed: u64) -> Backoff {
        Backoff::new(Reconnection::default(), ChaCha8Rng::seed_from_u64(seed))
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
