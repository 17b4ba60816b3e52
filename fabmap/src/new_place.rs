//! How likely an observation is somewhere that is not on the map.

use std::sync::Arc;

use crate::appearance::Appearance;
use crate::inverted_index::InvertedIndex;
use crate::likelihood::ObservationModel;
use crate::observation::Observation;

/// How the places nobody has seen are stood in for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NewPlaceMethod {
    /// By one average place. Cummins & Newman 2008, eq. (16).
    MeanField,
    /// By a sampling set: observations of other places, each a place of its own. Cummins & Newman
    /// 2008, eq. (17).
    #[default]
    Sampled,
}

/// The new-place term ln p(Z | L_new).
#[derive(Clone, Debug)]
pub struct NewPlace {
    stand_in: StandIn,
}

#[derive(Clone, Debug)]
enum StandIn {
    AveragePlace(Arc<ObservationModel>),
    Samples(Box<InvertedIndex>),
}

/// The sampled method was asked for without samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the model has no sampling set; use the mean-field method, or train a model with one")]
pub struct NoSamplesError;

impl NewPlace {
    /// # Errors
    /// [`NoSamplesError`] if the method is [`NewPlaceMethod::Sampled`] and the sampling set is empty.
    pub fn new(
        method: NewPlaceMethod,
        model: &Arc<ObservationModel>,
        sampling_set: &[Observation],
    ) -> Result<Self, NoSamplesError> {
        let stand_in = match method {
            NewPlaceMethod::MeanField => StandIn::AveragePlace(model.clone()),
            NewPlaceMethod::Sampled if sampling_set.is_empty() => return Err(NoSamplesError),
            NewPlaceMethod::Sampled => {
                let mut samples = InvertedIndex::new(model.clone());
                for sample in sampling_set {
                    samples.add(Appearance::of(sample));
                }
                StandIn::Samples(Box::new(samples))
            }
        };
        Ok(Self { stand_in })
    }

    /// ln p(Z | L_avg), or ln [(1/n_s) Σ_u p(Z | L_u)] over the n_s samples.
    #[must_use]
    pub fn log_likelihood(&self, observation: &Observation) -> f64 {
        match &self.stand_in {
            StandIn::AveragePlace(model) => {
                model.log_likelihood_of_empty_place(&model.informative_words(observation), 0)
            }
            StandIn::Samples(samples) => {
                let scores = samples.log_likelihoods(observation);
                log_sum_exp(&scores) - (scores.len() as f64).ln()
            }
        }
    }

    /// The method in use.
    #[must_use]
    pub fn method(&self) -> NewPlaceMethod {
        match self.stand_in {
            StandIn::AveragePlace(_) => NewPlaceMethod::MeanField,
            StandIn::Samples(_) => NewPlaceMethod::Sampled,
        }
    }
}

/// ln Σ exp(x), without overflow; -∞ for an empty sum.
pub(crate) fn log_sum_exp(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + values.iter().map(|value| (value - largest).exp()).sum::<f64>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_worlds::{self, World};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_sampled_term_is_the_mean_over_the_samples(world in test_worlds::worlds(20, 2)) {
            let World { model, observations, .. } = world;
            let model = Arc::new(model);
            let new_place = NewPlace::new(NewPlaceMethod::Sampled, &model, &observations).unwrap();
            for z in &observations {
                let mean = observations.iter()
                    .map(|sample| model.dense_log_likelihood(z, &Appearance::of(sample)).exp())
                    .sum::<f64>() / observations.len() as f64;
                let term = new_place.log_likelihood(z);
                prop_assert!((term - mean.ln()).abs() <= 1e-9 * term.abs().max(1.0), "{term} {}", mean.ln());
            }
        }

        #[test]
        fn log_sum_exp_is_the_plain_sum(values in proptest::collection::vec(-20.0..20.0f64, 1..30)) {
            let plain = values.iter().map(|v| v.exp()).sum::<f64>().ln();
            prop_assert!((log_sum_exp(&values) - plain).abs() < 1e-9);
        }
    }

    #[test]
    fn a_sum_of_tiny_likelihoods_is_not_zero() {
        assert!((log_sum_exp(&[-5000.0, -5000.0]) - (-5000.0 + 2f64.ln())).abs() < 1e-9);
        assert_eq!(log_sum_exp(&[]), f64::NEG_INFINITY);
    }

    #[test]
    fn sampling_needs_samples() {
        let World { model, .. } = test_worlds::fixed(5, 1, 1);
        assert!(NewPlace::new(NewPlaceMethod::Sampled, &Arc::new(model), &[]).is_err());
    }
}
