//! Where the robot may be before an observation.

use crate::appearance::PlaceId;

/// p(L_i) before an observation: the same for all places but some, and for "somewhere new". Sums to
/// 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacePrior {
    pub(super) places: usize,
    pub(super) everywhere: f64,
    /// What some places have beyond that; ascending by id, each at most once.
    pub(super) more: Vec<(PlaceId, f64)>,
    pub(super) new_place: f64,
}

/// Where motion alone puts the robot among the known places: weights of some places and a mass
/// spread evenly over all, 1 in sum.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionPrior {
    pub(super) places: Vec<(PlaceId, f64)>,
    pub(super) even: f64,
}

impl PlacePrior {
    /// p(L_i); `None` if there is no such place.
    #[must_use]
    pub fn of(&self, place: PlaceId) -> Option<f64> {
        let more = self.more.binary_search_by_key(&place, |&(place, _)| place);
        let more = more.map_or(0.0, |index| self.more[index].1);
        (place.index() < self.places).then_some(self.everywhere + more)
    }

    /// p(new).
    #[must_use]
    pub fn new_place(&self) -> f64 {
        self.new_place
    }
}

impl MotionPrior {
    /// All places alike.
    #[must_use]
    pub fn even() -> Self {
        Self { places: Vec::new(), even: 1.0 }
    }

    /// Normalises weights (finite, at least 0) of some places and of all places together. Weights
    /// of one place add up; if all are 0 the prior is even.
    #[must_use]
    pub fn from_weights(mut places: Vec<(PlaceId, f64)>, even: f64) -> Self {
        places.sort_by_key(|&(place, _)| place);
        places.dedup_by(|later, earlier| {
            let same = later.0 == earlier.0;
            if same {
                earlier.1 += later.1;
            }
            same
        });
        let total = places.iter().map(|&(_, weight)| weight).sum::<f64>() + even;
        if !(total > 0.0 && total.is_finite()) {
            return Self::even();
        }
        places.iter_mut().for_each(|(_, weight)| *weight /= total);
        Self { places, even: even / total }
    }
}
