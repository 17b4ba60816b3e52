//! Where the robot is after an observation, and what of it is carried to the next.

use crate::appearance::PlaceId;
use crate::slices;

/// Probabilities over n places and "somewhere new" that sum to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlaceDistribution {
    /// One probability per place, in order of place id.
    pub places: Vec<f64>,
    /// Probability of being at none of them.
    pub new_place: f64,
}

/// What is carried from one frame to the next: at most [`Belief::MAX_PLACES`] places, p(new), and
/// the rest, held to be spread evenly. Sums to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// The most probable places, ascending by id, each at most once.
    pub places: Vec<(PlaceId, f64)>,
    /// p(new).
    pub new_place: f64,
    /// What all other places share.
    pub remainder: f64,
}

/// Places that are passed over at once if none of them is among the best.
const CHUNK_PLACES: usize = 64;

impl PlaceDistribution {
    /// The most probable place and its probability; the lower id of equal ones.
    #[must_use]
    pub fn best_place(&self) -> Option<(PlaceId, f64)> {
        self.top(1).first().copied()
    }

    /// ln [p / (1 - p)] of a place, in nats: it tells apart probabilities that all round to 1.
    /// Taken from the sum of all others, so that it keeps its precision there; at most about 708.
    ///
    /// # Panics
    /// If there is no such place.
    #[must_use]
    pub fn log_odds(&self, place: PlaceId) -> f64 {
        let (before, rest) = self.places.split_at(place.index());
        let others = slices::sum(before) + slices::sum(&rest[1..]) + self.new_place;
        rest[0].max(f64::MIN_POSITIVE).ln() - others.max(f64::MIN_POSITIVE).ln()
    }

    /// The `count` most probable places, most probable first, ties by id.
    #[must_use]
    pub fn top(&self, count: usize) -> Vec<(PlaceId, f64)> {
        let by_probability =
            |a: &(PlaceId, f64), b: &(PlaceId, f64)| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0));
        let count = count.min(self.places.len());
        let mut best: Vec<(PlaceId, f64)> = Vec::with_capacity(2 * (count + 1));
        if count == 0 {
            return best;
        }
        // What the last of the best must be exceeded by; of equal ones the earlier is the better.
        let mut least = f64::NEG_INFINITY;
        for (first, chunk) in (0..).step_by(CHUNK_PLACES).zip(self.places.chunks(CHUNK_PLACES)) {
            if !chunk.iter().fold(false, |any, &probability| any | (probability > least)) {
                continue;
            }
            for (place, &probability) in (first..).zip(chunk) {
                if probability > least {
                    best.push((PlaceId::new(place), probability));
                }
                if best.len() == best.capacity() {
                    least = best.select_nth_unstable_by(count - 1, by_probability).1.1;
                    best.truncate(count);
                }
            }
        }
        best.sort_unstable_by(by_probability);
        best.truncate(count);
        best
    }

    /// What the next frame starts from. The mass of "somewhere new" passes to `created`, the place
    /// made from this frame if one was; it must be the next place id.
    #[must_use]
    pub fn carry(&self, created: Option<PlaceId>) -> Belief {
        let kept = Belief::MAX_PLACES - usize::from(created.is_some());
        let mut places = self.top(kept);
        let mut new_place = self.new_place;
        if let Some(created) = created {
            places.push((created, std::mem::take(&mut new_place)));
        }
        places.sort_unstable_by_key(|&(place, _)| place);
        let carried = places.iter().map(|&(_, probability)| probability).sum::<f64>() + new_place;
        Belief { places, new_place, remainder: (1.0 - carried).max(0.0) }
    }
}

impl Belief {
    /// Most places carried by name.
    pub const MAX_PLACES: usize = 64;

    /// Nothing is known: a session begins.
    #[must_use]
    pub fn unknown() -> Self {
        Self { places: Vec::new(), new_place: 0.0, remainder: 1.0 }
    }
}
