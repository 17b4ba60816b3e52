//! The recursive Bayes filter over places, "somewhere new" included.

use rayon::prelude::*;

use crate::appearance::PlaceId;
use crate::new_place::NewPlaceTerm;
use crate::slices;

/// Settings of the filter; every value is checked by [`PlaceFilter::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterSettings {
    /// p(new): prior probability that the robot is at a place it has never seen, in (0, 1).
    pub new_place_prior: f64,
    /// ε: share of the rest that is spread evenly over all places, so that none is ruled out by the
    /// motion prior; in (0, 1].
    pub even_share: f64,
    /// σ: weight of the normalised likelihoods against an even distribution, in (0, 1]; 1, the
    /// default, leaves them as they are. Cummins & Newman 2008, eq. (18). Below 1 no single frame can
    /// be convincing, which spares wrong closures and also levels the evidence that ranks the right
    /// ones.
    pub likelihood_smoothing: f64,
}

impl Default for FilterSettings {
    fn default() -> Self {
        Self { new_place_prior: 0.9, even_share: 0.1, likelihood_smoothing: 1.0 }
    }
}

/// A setting of the filter is out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// p(new) out of range.
    #[error("the prior of a new place must lie between 0 and 1, not {value}; 0.9 is a good start")]
    NewPlacePrior {
        /// The value given.
        value: f64,
    },
    /// ε out of range.
    #[error("the even share must be above 0 and at most 1, not {value}; 0.1 is a good start")]
    EvenShare {
        /// The value given.
        value: f64,
    },
    /// σ out of range.
    #[error(
        "likelihood smoothing must be above 0 and at most 1, not {value}; 1 is none, 0.99 what the papers use"
    )]
    LikelihoodSmoothing {
        /// The value given.
        value: f64,
    },
}

/// Probabilities over n places and "somewhere new" that sum to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlaceDistribution {
    /// One probability per place, in order of place id.
    pub places: Vec<f64>,
    /// Probability of being at none of them.
    pub new_place: f64,
}

/// p(L_i) before an observation: the same for all places but some, and for "somewhere new". Sums to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacePrior {
    places: usize,
    everywhere: f64,
    /// What some places have beyond that; ascending by id, each at most once.
    more: Vec<(PlaceId, f64)>,
    new_place: f64,
}

/// Where motion alone puts the robot among the known places: weights of some places and a mass
/// spread evenly over all, 1 in sum.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionPrior {
    places: Vec<(PlaceId, f64)>,
    even: f64,
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

/// The recursive Bayes filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceFilter {
    settings: FilterSettings,
}

impl PlaceFilter {
    /// # Errors
    /// [`FilterError`] if a setting is out of range.
    pub fn new(settings: FilterSettings) -> Result<Self, FilterError> {
        let FilterSettings { new_place_prior, even_share, likelihood_smoothing } = settings;
        if !(new_place_prior > 0.0 && new_place_prior < 1.0) {
            return Err(FilterError::NewPlacePrior { value: new_place_prior });
        }
        if !(even_share > 0.0 && even_share <= 1.0) {
            return Err(FilterError::EvenShare { value: even_share });
        }
        if !(likelihood_smoothing > 0.0 && likelihood_smoothing <= 1.0) {
            return Err(FilterError::LikelihoodSmoothing { value: likelihood_smoothing });
        }
        Ok(Self { settings })
    }

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> FilterSettings {
        self.settings
    }

    /// p(L_i | Z^k) from the log-likelihoods of all places and of a new one, tempered as that says, and the prior.
    /// Cummins & Newman 2008, eqs. (4), (18).
    ///
    /// # Panics
    /// If prior and likelihoods are not of the same places.
    #[must_use]
    pub fn update(
        &self,
        log_likelihoods: &[f64],
        new_place: &NewPlaceTerm,
        prior: &PlacePrior,
    ) -> PlaceDistribution {
        let mut posterior = PlaceDistribution::default();
        self.update_into(log_likelihoods, new_place, prior, &mut posterior);
        posterior
    }

    /// The same into `posterior`, which is overwritten.
    ///
    /// Twice through the places: likelihoods relative to the largest; then a factor and an offset that are the same
    /// for all places but those that the prior names.
    ///
    /// # Panics
    /// See [`PlaceFilter::update`].
    pub fn update_into(
        &self,
        log_likelihoods: &[f64],
        new_place: &NewPlaceTerm,
        prior: &PlacePrior,
        posterior: &mut PlaceDistribution,
    ) {
        let places = log_likelihoods.len();
        assert_eq!(places, prior.places, "prior and likelihoods of different maps");
        let &NewPlaceTerm { log_likelihood: new_place, temperature } = new_place;
        // Tempering moves no place across the new one, so the largest of all stays the largest.
        let largest = slices::largest(log_likelihoods).max(new_place);
        posterior.places.resize(places, 0.0);
        let likelihoods = &mut posterior.places;
        let sum = exponentials(log_likelihoods, largest, 1.0 / temperature, likelihoods);
        let new_place = ((new_place - largest) / temperature).exp();

        let sigma = self.settings.likelihood_smoothing;
        let (factor, even) = (sigma / (sum + new_place), (1.0 - sigma) / (places as f64 + 1.0));
        let smoothed = |likelihood: f64| factor * likelihood + even;
        let more: f64 =
            prior.more.iter().map(|&(place, more)| more * smoothed(likelihoods[place as usize])).sum();
        let of_all = prior.everywhere * (factor * sum + even * places as f64);
        let of_new_place = prior.new_place * smoothed(new_place);
        let evidence = of_all + more + of_new_place;

        let more = prior.more.iter().map(|&(place, more)| {
            (place as usize, (prior.everywhere + more) * smoothed(likelihoods[place as usize]) / evidence)
        });
        let more: Vec<(usize, f64)> = more.collect();
        scale(likelihoods, prior.everywhere * factor / evidence, prior.everywhere * even / evidence);
        more.into_iter().for_each(|(place, probability)| likelihoods[place] = probability);
        posterior.new_place = of_new_place / evidence;
    }

    /// p(L_i) before the observation: p(new) for a new place; the rest to the n known ones as
    /// (1 - ε) · motion prior + ε/n. Without places all of it is new.
    #[must_use]
    pub fn prior(&self, motion: &MotionPrior, places: usize) -> PlacePrior {
        if places == 0 {
            return PlacePrior { new_place: 1.0, ..PlacePrior::default() };
        }
        let FilterSettings { new_place_prior, even_share, .. } = self.settings;
        let known = 1.0 - new_place_prior;
        let everywhere = known * ((1.0 - even_share) * motion.even + even_share) / places as f64;
        let named = motion.places.iter().filter(|&&(place, _)| (place as usize) < places);
        let more = named.map(|&(place, weight)| (place, known * (1.0 - even_share) * weight)).collect();
        PlacePrior { places, everywhere, more, new_place: new_place_prior }
    }
}

impl PlacePrior {
    /// p(L_i); `None` if there is no such place.
    #[must_use]
    pub fn of(&self, place: PlaceId) -> Option<f64> {
        let more = self.more.binary_search_by_key(&place, |&(place, _)| place);
        let more = more.map_or(0.0, |index| self.more[index].1);
        ((place as usize) < self.places).then_some(self.everywhere + more)
    }

    /// p(new).
    #[must_use]
    pub fn new_place(&self) -> f64 {
        self.new_place
    }
}

/// Places that one thread works on at a time; sums over them are added in order.
const BLOCK_PLACES: usize = 4096;

/// exp((l - largest) · scale) of all places, and the sum.
fn exponentials(log_likelihoods: &[f64], largest: f64, scale: f64, likelihoods: &mut [f64]) -> f64 {
    let blocks = log_likelihoods.par_chunks(BLOCK_PLACES).zip(likelihoods.par_chunks_mut(BLOCK_PLACES));
    let sums = blocks.map(|(values, results)| slices::exponentials(values, largest, scale, results));
    sums.collect::<Vec<f64>>().iter().sum()
}

fn scale(probabilities: &mut [f64], factor: f64, offset: f64) {
    probabilities.par_chunks_mut(BLOCK_PLACES).for_each(|block| slices::scale(block, factor, offset));
}

impl PlaceDistribution {
    /// The most probable place and its probability; the lower id of equal ones.
    #[must_use]
    pub fn best_place(&self) -> Option<(PlaceId, f64)> {
        self.top(1).first().copied()
    }

    /// ln [p / (1 - p)] of a place, in nats: it tells apart probabilities that all round to 1. Taken
    /// from the sum of all others, so that it keeps its precision there; at most about 708.
    ///
    /// # Panics
    /// If there is no such place.
    #[must_use]
    pub fn log_odds(&self, place: PlaceId) -> f64 {
        let (before, rest) = self.places.split_at(place as usize);
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
                    best.push((place, probability));
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

/// Places that are passed over at once if none of them is among the best.
const CHUNK_PLACES: usize = 64;

impl Belief {
    /// Most places carried by name.
    pub const MAX_PLACES: usize = 64;

    /// Nothing is known: a session begins.
    #[must_use]
    pub fn unknown() -> Self {
        Self { places: Vec::new(), new_place: 0.0, remainder: 1.0 }
    }
}

impl MotionPrior {
    /// All places alike.
    #[must_use]
    pub fn even() -> Self {
        Self { places: Vec::new(), even: 1.0 }
    }

    /// Normalises weights (finite, at least 0) of some places and of all places together. Weights of
    /// one place add up; if all are 0 the prior is even.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn filters() -> impl Strategy<Value = PlaceFilter> {
        (0.01..0.99f64, 0.001..=1.0f64, 0.5..=1.0f64).prop_map(
            |(new_place_prior, even_share, likelihood_smoothing)| {
                PlaceFilter::new(FilterSettings { new_place_prior, even_share, likelihood_smoothing })
                    .unwrap()
            },
        )
    }

    fn motion_priors() -> impl Strategy<Value = MotionPrior> {
        (proptest::collection::vec((0..30u32, 0.0..1.0f64), 0..10), 0.0..1.0f64)
            .prop_map(|(places, even)| MotionPrior::from_weights(places, even))
    }

    fn total(distribution: &PlaceDistribution) -> f64 {
        distribution.places.iter().sum::<f64>() + distribution.new_place
    }

    fn untempered(log_likelihood: f64) -> NewPlaceTerm {
        NewPlaceTerm { log_likelihood, temperature: 1.0 }
    }

    fn all(prior: &PlacePrior) -> Vec<f64> {
        (0..prior.places as PlaceId).map(|place| prior.of(place).unwrap()).collect()
    }

    proptest! {
        #[test]
        fn prior_and_posterior_sum_to_1(
            filter in filters(), motion in motion_priors(), likelihoods in proptest::collection::vec(-800.0..0.0f64, 30..60), new in -800.0..0.0f64,
        ) {
            let prior = filter.prior(&motion, likelihoods.len());
            prop_assert!((all(&prior).iter().sum::<f64>() + prior.new_place() - 1.0).abs() < 1e-12);
            prop_assert!((prior.new_place() - filter.settings().new_place_prior).abs() < 1e-12);
            prop_assert_eq!(prior.of(likelihoods.len() as PlaceId), None);
            let posterior = filter.update(&likelihoods, &untempered(new), &prior);
            prop_assert!((total(&posterior) - 1.0).abs() < 1e-12);
            prop_assert!(posterior.places.iter().all(|p| (0.0..=1.0).contains(p)));
        }

        /// Bayes' rule in plain arithmetic, on likelihoods that do not underflow.
        #[test]
        fn the_posterior_is_bayes_rule(
            filter in filters(), motion in motion_priors(), likelihoods in proptest::collection::vec(-30.0..0.0f64, 30..40), new in -30.0..0.0f64,
            temperature in prop_oneof![Just(1.0), 1.0..20.0f64],
        ) {
            let settings = filter.settings();
            let n = likelihoods.len() as f64;
            let term = NewPlaceTerm { log_likelihood: new, temperature };
            let likelihoods_of_all = &likelihoods;
            let likelihoods: Vec<f64> = likelihoods_of_all.iter().map(|l| new + (l - new) / temperature).collect();
            let sum: f64 = likelihoods.iter().map(|l| l.exp()).sum::<f64>() + new.exp();
            let smooth = |l: f64| settings.likelihood_smoothing * l.exp() / sum + (1.0 - settings.likelihood_smoothing) / (n + 1.0);
            let prior = filter.prior(&motion, likelihoods.len());
            let joint: Vec<f64> = likelihoods.iter().zip(all(&prior)).map(|(&l, p)| smooth(l) * p).collect();
            let joint_new = smooth(new) * prior.new_place();
            let evidence: f64 = joint.iter().sum::<f64>() + joint_new;
            let posterior = filter.update(likelihoods_of_all, &term, &prior);
            for (p, j) in posterior.places.iter().zip(&joint) {
                prop_assert!((p - j / evidence).abs() < 1e-12);
            }
            prop_assert!((posterior.new_place - joint_new / evidence).abs() < 1e-12);
        }

        #[test]
        fn carrying_loses_no_mass(
            weights in proptest::collection::vec(0.0..1.0f64, 1..200), new in 0.001..1.0f64, creates in any::<bool>(),
        ) {
            let all = weights.iter().sum::<f64>() + new;
            let places = weights.iter().map(|weight| weight / all).collect();
            let distribution = PlaceDistribution { places, new_place: new / all };
            let next = distribution.places.len() as PlaceId;
            let belief = distribution.carry(creates.then_some(next));
            prop_assert!(belief.places.len() <= Belief::MAX_PLACES);
            prop_assert!(belief.places.is_sorted_by(|a, b| a.0 < b.0));
            let sum = belief.places.iter().map(|p| p.1).sum::<f64>() + belief.new_place + belief.remainder;
            prop_assert!((sum - 1.0).abs() < 1e-9);
            prop_assert_eq!(creates, belief.places.last().is_some_and(|p| p.0 == next && p.1 == distribution.new_place));
        }

        #[test]
        fn top_is_the_sorted_beginning(weights in proptest::collection::vec(0..30u8, 0..400), count in 0..60usize) {
            let distribution = PlaceDistribution { places: weights.iter().map(|&w| f64::from(w)).collect(), new_place: 0.0 };
            let mut sorted: Vec<(PlaceId, f64)> = (0..).zip(distribution.places.iter().copied()).collect();
            sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
            sorted.truncate(count);
            prop_assert_eq!(distribution.top(count), sorted);
        }
    }

    #[test]
    fn log_odds_tell_near_certainties_apart() {
        let near = |doubt: f64| PlaceDistribution { places: vec![doubt, 1.0], new_place: 0.0 };
        assert!(near(1e-30).log_odds(1) > near(1e-20).log_odds(1));
        assert!((near(1e-20).log_odds(1) - 20.0 * 10f64.ln()).abs() < 1e-9);
        assert!(near(0.0).log_odds(1).is_finite() && near(0.0).log_odds(0).is_finite());
        let even = PlaceDistribution { places: vec![0.25, 0.25], new_place: 0.5 };
        assert!((even.log_odds(0) - (0.25f64 / 0.75).ln()).abs() < 1e-15);
    }

    #[test]
    fn an_empty_map_has_only_new_places() {
        let filter = PlaceFilter::new(FilterSettings::default()).unwrap();
        let prior = filter.prior(&MotionPrior::even(), 0);
        let posterior = filter.update(&[], &untempered(-100.0), &prior);
        assert_eq!(posterior, PlaceDistribution { places: vec![], new_place: 1.0 });
    }

    #[test]
    fn motion_moves_the_mass_where_it_says() {
        let filter = PlaceFilter::new(FilterSettings::default()).unwrap();
        let prior = filter.prior(&MotionPrior::from_weights(vec![(3, 2.0), (1, 1.0), (3, 1.0)], 0.0), 5);
        assert!((prior.of(3).unwrap() - 0.1 * (0.9 * 0.75 + 0.1 / 5.0)).abs() < 1e-15);
        assert!((prior.of(0).unwrap() - 0.1 * 0.1 / 5.0).abs() < 1e-15);
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let refused = |settings| PlaceFilter::new(settings).unwrap_err();
        let good = FilterSettings::default();
        for value in [0.0, 1.0, f64::NAN] {
            assert!(matches!(
                refused(FilterSettings { new_place_prior: value, ..good }),
                FilterError::NewPlacePrior { .. }
            ));
        }
        for value in [0.0, 1.1, f64::NAN] {
            assert!(matches!(
                refused(FilterSettings { even_share: value, ..good }),
                FilterError::EvenShare { .. }
            ));
            let smoothing = FilterSettings { likelihood_smoothing: value, ..good };
            assert!(matches!(refused(smoothing), FilterError::LikelihoodSmoothing { .. }));
        }
    }
}
