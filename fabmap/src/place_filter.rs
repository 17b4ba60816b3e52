//! The recursive Bayes filter over places, "somewhere new" included.

mod distribution;
mod prior;
mod settings;

use rayon::prelude::*;

use crate::new_place::NewPlaceTerm;
use crate::slices;

pub use distribution::{Belief, PlaceDistribution};
pub use prior::{MotionPrior, PlacePrior};
pub use settings::{FilterError, FilterSettings};

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

    /// p(L_i | Z^k) from the log-likelihoods of all places and of a new one, tempered as that says,
    /// and the prior. Cummins & Newman 2008, eqs. (4), (18).
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
    /// Twice through the places: likelihoods relative to the largest; then a factor and an offset
    /// that are the same for all places but those that the prior names.
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
        let factor = sigma / (sum + new_place);
        let even = (1.0 - sigma) / (places as f64 + 1.0);
        let smoothed = |likelihood: f64| factor * likelihood + even;
        let more: f64 =
            prior.more.iter().map(|&(place, more)| more * smoothed(likelihoods[place.index()])).sum();
        let of_all = prior.everywhere * (factor * sum + even * places as f64);
        let of_new_place = prior.new_place * smoothed(new_place);
        let evidence = of_all + more + of_new_place;

        let more = prior.more.iter().map(|&(place, more)| {
            (place.index(), (prior.everywhere + more) * smoothed(likelihoods[place.index()]) / evidence)
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
        let named = motion.places.iter().filter(|&&(place, _)| place.index() < places);
        let more = named.map(|&(place, weight)| (place, known * (1.0 - even_share) * weight)).collect();
        PlacePrior { places, everywhere, more, new_place: new_place_prior }
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

#[cfg(test)]
mod tests;
