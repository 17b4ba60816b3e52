//! Which images are taken when there are more than can be worked off: a robot that is refused gets a
//! place in line, and the time when it comes up.
//!
//! Without the line, robots that were lucky once would keep the queue full and the others out: each image
//! that is done makes room for the next of the same robot, before any other comes back.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Images of robots that may wait for each core. Beyond that they would be late for any robot.
const WAITING_PER_CORE: usize = 16;

/// With fewer images on hand for each core, the next to come is taken: no core idles for those in line.
const ENOUGH_PER_CORE: usize = 4;

/// How late a robot may come for its turn.
const GRACE: Duration = Duration::from_secs(1);

const MIN_RETRY: Duration = Duration::from_millis(100);
const MAX_RETRY: Duration = Duration::from_secs(30);

/// Bounds the images on hand. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct Admission {
    queue: Arc<Mutex<Queue>>,
}

#[derive(Debug)]
struct Queue {
    cores: usize,
    /// Images that wait or are worked on.
    on_hand: usize,
    /// When the last image was done.
    last_done: Option<Instant>,
    /// From one image done to the next of late, while there was work for every core.
    interval: Duration,
    /// Streams that were refused, in the order of their turns.
    in_line: VecDeque<Turn>,
}

#[derive(Debug)]
struct Turn {
    stream: u64,
    due: Instant,
}

/// An image on hand; makes room when dropped.
#[derive(Debug)]
pub(super) struct Admitted {
    queue: Arc<Mutex<Queue>>,
}

/// What waits for cores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Backlog {
    /// Images that wait or are worked on.
    pub(crate) on_hand: usize,
    /// Streams that were refused and have a turn to come.
    pub(crate) in_line: usize,
}

impl Admission {
    pub(super) fn new(cores: usize) -> Self {
        let last_done = None;
        let interval = Duration::ZERO;
        let in_line = VecDeque::new();
        Self { queue: Arc::new(Mutex::new(Queue { cores, on_hand: 0, last_done, interval, in_line })) }
    }

    /// So many images can be worked on side by side from now on.
    pub(super) fn set_cores(&self, cores: usize) {
        lock(&self.queue).cores = cores;
    }

    pub(super) fn backlog(&self, now: Instant) -> Backlog {
        let mut queue = lock(&self.queue);
        queue.in_line.retain(|turn| now < turn.due + GRACE);
        Backlog { on_hand: queue.on_hand, in_line: queue.in_line.len() }
    }

    /// Takes an image, or says when to come again. `stream` is whose turn it may be; a sender without one is
    /// never given a place in line.
    pub(super) fn admit(&self, stream: Option<u64>, now: Instant) -> Result<Admitted, Duration> {
        let mut queue = lock(&self.queue);
        queue.in_line.retain(|turn| now < turn.due + GRACE);
        let own = queue.in_line.iter().position(|turn| Some(turn.stream) == stream);
        let others_first = queue.in_line.iter().take(own.unwrap_or(usize::MAX));
        let kept_free = others_first.filter(|turn| turn.due <= now).count();
        let few = queue.on_hand < queue.cores * ENOUGH_PER_CORE;
        if few || queue.on_hand + kept_free < queue.cores * (1 + WAITING_PER_CORE) {
            own.and_then(|own| queue.in_line.remove(own));
            queue.on_hand += 1;
            return Ok(Admitted { queue: self.queue.clone() });
        }
        Err(queue.line_up(stream, own, now))
    }
}

impl Queue {
    /// Gives how long the stream has to wait for its turn.
    fn line_up(&mut self, stream: Option<u64>, own: Option<usize>, now: Instant) -> Duration {
        // When half of those that wait are done, there is room again.
        let ahead = own.unwrap_or(self.in_line.len()) + self.cores * WAITING_PER_CORE / 2;
        let wait = self.interval.mul_f64(ahead as f64).clamp(MIN_RETRY, MAX_RETRY);
        match own.and_then(|own| self.in_line.get_mut(own)) {
            Some(turn) if turn.due > now => turn.due - now,
            Some(turn) => {
                turn.due = now + wait;
                wait
            }
            None => {
                self.in_line.extend(stream.map(|stream| Turn { stream, due: now + wait }));
                wait
            }
        }
    }
}

impl Admitted {
    /// Notes that it has been worked on: how fast images are done tells others how long to wait.
    pub(super) fn done(&self, now: Instant) {
        let mut queue = lock(&self.queue);
        let last_done = queue.last_done.replace(now);
        // With a core free, it would tell how fast robots send.
        if let Some(last_done) = last_done.filter(|_| queue.on_hand > queue.cores) {
            let before = queue.interval;
            let latest = now.saturating_duration_since(last_done);
            queue.interval = if before.is_zero() { latest } else { (before * 15 + latest) / 16 };
        }
    }
}

impl Drop for Admitted {
    fn drop(&mut self) {
        lock(&self.queue).on_hand -= 1;
    }
}

fn lock(queue: &Mutex<Queue>) -> MutexGuard<'_, Queue> {
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    const IMAGE: Duration = Duration::from_millis(60);
    const CAPACITY: usize = 1 + WAITING_PER_CORE;

    /// One core that is busy with as much as it takes, all of it from stream 0.
    fn full(now: Instant) -> (Admission, Vec<Admitted>) {
        let admission = Admission::new(1);
        let on_hand: Vec<Admitted> = (0..CAPACITY).map(|_| admission.admit(Some(0), now).unwrap()).collect();
        on_hand[0].done(now);
        on_hand[1].done(now + IMAGE);
        (admission, on_hand)
    }

    #[test]
    fn those_who_were_refused_come_first_and_in_turn() {
        let mut now = Instant::now();
        let (admission, mut on_hand) = full(now);
        let waits: Vec<Duration> =
            (1..=3).map(|stream| admission.admit(Some(stream), now).unwrap_err()).collect();
        assert!(waits.is_sorted() && waits[2] - waits[0] == 2 * IMAGE, "{waits:?}");
        assert_eq!(admission.backlog(now), Backlog { on_hand: CAPACITY, in_line: 3 });
        // One that asks early hears the same time.
        assert_eq!(admission.admit(Some(2), now + IMAGE).unwrap_err(), waits[1] - IMAGE);

        now += waits[2];
        drop(on_hand.drain(..2));
        // Two places for three whose turn it is: stream 0 may not have one, nor may the third.
        assert!(admission.admit(Some(0), now).is_err());
        assert!(admission.admit(Some(3), now).is_err());
        on_hand.push(admission.admit(Some(2), now).unwrap());
        on_hand.push(admission.admit(Some(1), now).unwrap());
        assert!(admission.admit(Some(3), now).is_err());
        assert!(admission.admit(None, now).is_err());
        drop(on_hand.drain(..1));
        on_hand.push(admission.admit(Some(3), now).unwrap());
    }

    #[test]
    fn places_of_those_who_do_not_come_back_are_given_away() {
        let now = Instant::now();
        let (admission, mut on_hand) = full(now);
        let waits: Vec<Duration> =
            (1..=CAPACITY as u64).map(|stream| admission.admit(Some(stream), now).unwrap_err()).collect();
        let last_turn = now + *waits.last().unwrap();
        // All room there is is kept free, but a core must not idle for that.
        on_hand.truncate(ENOUGH_PER_CORE);
        assert!(admission.admit(Some(99), last_turn).is_err());
        on_hand.pop();
        on_hand.push(admission.admit(Some(99), last_turn).unwrap());
        assert!(admission.admit(Some(99), last_turn).is_err());
        let over = last_turn + GRACE;
        on_hand.push(admission.admit(Some(99), over).unwrap());
        assert_eq!(admission.backlog(over).in_line, 0);
    }

    #[test]
    fn a_sender_without_a_stream_is_refused_but_keeps_nobody_out() {
        let now = Instant::now();
        let (admission, mut on_hand) = full(now);
        let wait = admission.admit(None, now).unwrap_err();
        assert!((MIN_RETRY..=MAX_RETRY).contains(&wait));
        on_hand.pop();
        on_hand.push(admission.admit(None, now + wait).unwrap());
        drop(on_hand);
        assert_eq!(lock(&admission.queue).on_hand, 0);
    }
}
