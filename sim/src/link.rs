//! What lies between robot and server: messages come late, or not at all.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How bad a link is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkSettings {
    /// Least time on the way, in nanoseconds.
    pub latency_ns: i64,
    /// Further delay, evenly distributed from 0 to this, in nanoseconds.
    pub jitter_ns: i64,
    /// Share of messages that are lost, in [0, 1].
    pub loss: f64,
    /// Whether messages can overtake each other.
    pub order: Order,
}

/// In which order messages come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// As they were sent, as over a stream: one that is late keeps back those after it.
    AsSent,
    /// As they come, as over datagrams.
    AsTheyCome,
}

/// Numbers that make no link.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// A message would come before it is sent, or after years.
    #[error("latency {latency_ns} ns and jitter {jitter_ns} ns; both must be from 0 to an hour")]
    Time {
        /// As given.
        latency_ns: i64,
        /// As given.
        jitter_ns: i64,
    },
    /// No share.
    #[error("a share of {loss} lost; it must be from 0 to 1")]
    Loss {
        /// As given.
        loss: f64,
    },
}

/// One direction of a link, in simulated time.
#[derive(Clone, Debug)]
pub struct Link<T> {
    settings: LinkSettings,
    random: ChaCha8Rng,
    on_the_way: BinaryHeap<Reverse<Message<T>>>,
    sent: u64,
    lost: u64,
    last_arrival_ns: i64,
}

#[derive(Clone, Debug)]
struct Message<T> {
    arrival_ns: i64,
    number: u64,
    content: T,
}

impl<T> Message<T> {
    fn key(&self) -> (i64, u64) {
        (self.arrival_ns, self.number)
    }
}

impl<T> PartialEq for Message<T> {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl<T> Eq for Message<T> {}

impl<T> PartialOrd for Message<T> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for Message<T> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key().cmp(&other.key())
    }
}

impl LinkSettings {
    /// Everything comes at once.
    pub const PERFECT: Self = Self { latency_ns: 0, jitter_ns: 0, loss: 0.0, order: Order::AsSent };
}

impl<T> Link<T> {
    /// # Errors
    /// [`LinkError`] if a number is out of its range.
    pub fn new(settings: LinkSettings, seed: u64) -> Result<Self, LinkError> {
        let LinkSettings { latency_ns, jitter_ns, loss, order: _ } = settings;
        let times = 0..=3_600_000_000_000;
        if !times.contains(&latency_ns) || !times.contains(&jitter_ns) {
            return Err(LinkError::Time { latency_ns, jitter_ns });
        }
        if !(0.0..=1.0).contains(&loss) {
            return Err(LinkError::Loss { loss });
        }
        let random = ChaCha8Rng::seed_from_u64(seed);
        Ok(Self {
            settings,
            random,
            on_the_way: BinaryHeap::new(),
            sent: 0,
            lost: 0,
            last_arrival_ns: i64::MIN,
        })
    }

    /// Sends a message at `now_ns`.
    pub fn send(&mut self, now_ns: i64, content: T) {
        let LinkSettings { latency_ns, jitter_ns, loss, order } = self.settings;
        // Drawn for every message, so that one setting does not change another's draws.
        let late = self.random.random::<f64>();
        let fate = self.random.random::<f64>();
        let number = self.sent;
        self.sent += 1;
        if fate < loss {
            self.lost += 1;
            return;
        }
        let mut arrival_ns = now_ns + latency_ns + (late * jitter_ns as f64) as i64;
        if order == Order::AsSent {
            arrival_ns = arrival_ns.max(self.last_arrival_ns);
            self.last_arrival_ns = arrival_ns;
        }
        self.on_the_way.push(Reverse(Message { arrival_ns, number, content }));
    }

    /// The next message that has come by `now_ns`, and when it came.
    pub fn receive(&mut self, now_ns: i64) -> Option<(i64, T)> {
        self.on_the_way.peek().filter(|Reverse(message)| message.arrival_ns <= now_ns)?;
        self.on_the_way.pop().map(|Reverse(message)| (message.arrival_ns, message.content))
    }

    /// When the next message comes, if one is on its way.
    #[must_use]
    pub fn next_arrival_ns(&self) -> Option<i64> {
        self.on_the_way.peek().map(|Reverse(message)| message.arrival_ns)
    }

    /// Messages sent and lost so far.
    #[must_use]
    pub fn sent_and_lost(&self) -> [u64; 2] {
        [self.sent, self.lost]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn as_many_are_lost_as_said_and_none_comes_early_or_late() {
        let settings =
            LinkSettings { latency_ns: 300 * MS, jitter_ns: 200 * MS, loss: 0.3, order: Order::AsTheyCome };
        let mut link = Link::new(settings, 5).unwrap();
        (0..10_000).for_each(|number| link.send(number * MS, number * MS));
        assert_eq!(link.receive(300 * MS - 1), None);
        let mut count = 0;
        let mut delay = 0.0;
        while let Some((arrival_ns, sent_ns)) = link.receive(i64::MAX) {
            assert!((300 * MS..=500 * MS).contains(&(arrival_ns - sent_ns)));
            count += 1;
            delay += (arrival_ns - sent_ns) as f64;
        }
        let [sent, lost] = link.sent_and_lost();
        assert_eq!((sent, lost), (10_000, 10_000 - count));
        assert!((2850..3150).contains(&lost), "{lost} of 10,000 lost");
        assert!((delay / count as f64 / MS as f64 - 400.0).abs() < 5.0);
    }

    proptest! {
        #[test]
        fn a_stream_keeps_its_order(seed in 0..100_u64, gaps in prop::collection::vec(0..50 * MS, 1..80)) {
            let settings = LinkSettings { latency_ns: 10 * MS, jitter_ns: 200 * MS, loss: 0.2, order: Order::AsSent };
            let mut link = Link::new(settings, seed).unwrap();
            let mut now_ns = 0;
            for (number, gap) in gaps.iter().enumerate() {
                now_ns += gap;
                link.send(now_ns, number);
            }
            let mut came = Vec::new();
            while let Some(arrival_ns) = link.next_arrival_ns() {
                prop_assert_eq!(link.receive(arrival_ns - 1), None);
                came.extend(link.receive(arrival_ns));
            }
            prop_assert!(came.windows(2).all(|pair| pair[0].0 <= pair[1].0 && pair[0].1 < pair[1].1));
        }
    }

    #[test]
    fn what_is_no_link_is_refused() {
        let refused = |settings| Link::<()>::new(settings, 0).err();
        let perfect = LinkSettings::PERFECT;
        assert_eq!(refused(LinkSettings { loss: 1.5, ..perfect }), Some(LinkError::Loss { loss: 1.5 }));
        let backwards = LinkSettings { latency_ns: -1, ..perfect };
        assert_eq!(refused(backwards), Some(LinkError::Time { latency_ns: -1, jitter_ns: 0 }));
    }
}
