//! Wrong secrets: no address sends many of them.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use crate::error::ServiceError;

const WINDOW: Duration = Duration::from_secs(60);

/// Addresses that are remembered at a time.
const MAX_ADDRESSES: usize = 4096;

/// Wrong secrets of the last minute, by the address that they came from.
#[derive(Debug)]
pub(super) struct Guesses {
    /// As many as one address may send.
    pub(super) per_minute: u32,
    by_address: HashMap<IpAddr, Counted>,
}

#[derive(Debug)]
struct Counted {
    since: Instant,
    guesses: u32,
}

impl Default for Guesses {
    fn default() -> Self {
        Self { per_minute: 1000, by_address: HashMap::new() }
    }
}

impl Guesses {
    /// One more wrong secret from `peer`; RESOURCE_EXHAUSTED if it sends too many.
    pub(super) fn count(&mut self, peer: Option<IpAddr>) -> Result<(), ServiceError> {
        let Some(peer) = peer else { return Ok(()) };
        if self.by_address.len() >= MAX_ADDRESSES && !self.by_address.contains_key(&peer) {
            self.by_address.retain(|_, counted| counted.since.elapsed() < WINDOW);
            if self.by_address.len() >= MAX_ADDRESSES {
                self.by_address.clear();
            }
        }
        let now = Instant::now();
        let counted = self.by_address.entry(peer).or_insert(Counted { since: now, guesses: 0 });
        if counted.since.elapsed() >= WINDOW {
            *counted = Counted { since: now, guesses: 0 };
        }
        counted.guesses = counted.guesses.saturating_add(1);
        if counted.guesses <= self.per_minute {
            return Ok(());
        }
        if counted.guesses == self.per_minute.saturating_add(1) {
            tracing::warn!(%peer, guesses = counted.guesses, "too many wrong tokens come from this address");
        }
        let message = format!(
            "more than {} wrong tokens came from {peer} within a minute; wait for a minute, then send the right one",
            self.per_minute
        );
        Err(ServiceError::QuotaUsedUp {
            message,
            retry_after: WINDOW.saturating_sub(counted.since.elapsed()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_so_many_guesses_a_minute_and_others_have_theirs() {
        let mut guesses = Guesses { per_minute: 2, ..Guesses::default() };
        let (one, other) = (Some([10, 0, 0, 1].into()), Some([10, 0, 0, 2].into()));
        assert_eq!([guesses.count(one), guesses.count(one)], [Ok(()), Ok(())]);
        let Err(ServiceError::QuotaUsedUp { retry_after, .. }) = guesses.count(one) else {
            panic!("a third guess")
        };
        assert!(retry_after > WINDOW / 2 && retry_after <= WINDOW);
        assert_eq!(guesses.count(other), Ok(()));
        guesses.by_address.values_mut().for_each(|counted| {
            counted.since = Instant::now().checked_sub(WINDOW).unwrap();
        });
        assert_eq!(guesses.count(one), Ok(()));
    }
}
