//! How likely an observation is somewhere that is not on the map.

mod tail;

use std::sync::Arc;

use crate::appearance::Appearance;
use crate::inverted_index::{InvertedIndex, QueryWeights};
use crate::likelihood::{ObservationModel, WordState};
use crate::observation::Observation;

use tail::Tail;

/// What stands in for the places that the map does not have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NewPlaceMethod {
    /// By one average place. Cummins & Newman 2008, eq. (16).
    MeanField,
    /// By a sampling set: observations of other places, each a place of its own. Cummins & Newman
    /// 2008, eq. (17).
    Sampled,
    /// By what the likeliest of as many unrelated places as the map has would reach, from the tail
    /// of the sampling set. The mean of a sample is outdone by the best of a large map; this grows
    /// with the map as that does.
    #[default]
    Tail,
    /// By the tail of the sampling set too, and likelihood ratios are tempered to it: a place is
    /// the more likely than "somewhere new" the rarer it is that an unrelated place is as likely.
    /// Words depend on each other in more ways than a tree has edges, so that untempered ratios
    /// overstate what they say. Posteriors come out much lower: a threshold for them must too.
    TemperedTail,
}

/// The new-place term for one observation and one map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewPlaceTerm {
    /// ln p(Z | L_new), nats.
    pub log_likelihood: f64,
    /// What log-likelihood ratios against it are to be divided by, at least 1.
    pub temperature: f64,
}

/// The new-place term ln p(Z | L_new).
#[derive(Clone, Debug)]
pub struct NewPlace {
    stand_in: StandIn,
}

#[derive(Clone, Debug)]
enum StandIn {
    AveragePlace(Arc<ObservationModel>),
    /// The samples as places that were looked at once.
    Samples(Box<InvertedIndex>, Summary),
}

/// Buffers for the term of one observation; reusing them saves allocations.
#[derive(Clone, Debug, Default)]
pub struct SampleWorkspace {
    weights: QueryWeights,
    log_likelihoods: Vec<f64>,
}

/// How the likelihoods of the samples are summed up.
#[derive(Clone, Copy, Debug)]
enum Summary {
    Mean,
    Tail,
    TemperedTail,
}

/// Samples were asked for, and there are none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the model has no sampling set; use the mean-field method, or train a model with one")]
pub struct NoSamplesError;

impl NewPlace {
    /// α: of the observations from somewhere new, the share for which the likeliest unrelated place
    /// may be as good as [`NewPlaceMethod::Tail`], its share of the prior considered.
    const MISTAKEN_SHARE: f64 = 0.01;

    /// c: density of ln p(Z | L) of a place that Z shows, per factor e of the tail. Such values
    /// spread over some twenty of them.
    const MATCHES_PER_FOLD: f64 = 0.05;

    /// # Errors
    /// [`NoSamplesError`] if the method needs a sampling set and it is empty.
    pub fn new(
        method: NewPlaceMethod,
        model: &Arc<ObservationModel>,
        sampling_set: &[Observation],
    ) -> Result<Self, NoSamplesError> {
        let stand_in = match method {
            NewPlaceMethod::MeanField => StandIn::AveragePlace(model.clone()),
            NewPlaceMethod::Sampled => Self::samples(model, sampling_set, Summary::Mean)?,
            NewPlaceMethod::Tail => Self::samples(model, sampling_set, Summary::Tail)?,
            NewPlaceMethod::TemperedTail => Self::samples(model, sampling_set, Summary::TemperedTail)?,
        };
        Ok(Self { stand_in })
    }

    fn samples(
        model: &Arc<ObservationModel>,
        sampling_set: &[Observation],
        summary: Summary,
    ) -> Result<StandIn, NoSamplesError> {
        if sampling_set.is_empty() {
            return Err(NoSamplesError);
        }
        let mut samples = InvertedIndex::new(model.clone());
        samples.extend(sampling_set.iter().map(Appearance::of));
        Ok(StandIn::Samples(Box::new(samples), summary))
    }

    /// Memory of the samples.
    pub(crate) fn memory_bytes(&self) -> usize {
        match &self.stand_in {
            StandIn::AveragePlace(_) => 0,
            StandIn::Samples(index, _) => index.memory_bytes(),
        }
    }

    /// The term for a map of n places, from the informative words of Z by the model that this
    /// was made with ([`ObservationModel::informative_words`]).
    ///
    /// - mean field: ln p(Z | L_avg);
    /// - sampled: ln [(1/n_s) Σ_u p(Z | L_u)] over the n_s samples;
    /// - tail: y - ln n, where y is exceeded by the likeliest of n unrelated places in a share α =
    ///   1 % of all observations; at least the sampled term. Such a place has 1/n of the prior that
    ///   all places share, so it is as good as "somewhere new" where ln p(Z | L) - ln n reaches
    ///   this;
    /// - tempered tail: such that p(Z | L) / p(Z | L_new), tempered, is c / P(an unrelated place is
    ///   as likely): the density of ln p(Z | L) at a place that Z shows over the density at one
    ///   that it does not, where the tail's is P / scale. With n places the best unrelated one
    ///   reaches about n c, whatever n is.
    #[must_use]
    pub fn term(
        &self,
        informative: &[WordState],
        places: usize,
        workspace: &mut SampleWorkspace,
    ) -> NewPlaceTerm {
        let untempered = |log_likelihood| NewPlaceTerm { log_likelihood, temperature: 1.0 };
        match &self.stand_in {
            StandIn::AveragePlace(model) => untempered(model.log_likelihood_of_empty_place(informative, 0)),
            StandIn::Samples(samples, summary) => {
                let SampleWorkspace { weights, log_likelihoods: scores } = workspace;
                samples.log_likelihoods_into(informative, weights, scores);
                match summary {
                    Summary::Mean => untempered(log_mean_exp(scores)),
                    Summary::Tail => {
                        let places = places.max(1);
                        let mean = log_mean_exp(scores);
                        let best = Tail::fit(scores).exceeded_by_best_of(places, Self::MISTAKEN_SHARE);
                        untempered(mean.max(best - (places as f64).ln()))
                    }
                    Summary::TemperedTail => {
                        let tail = Tail::fit(scores);
                        let log_likelihood = tail.exceeded_by_best_of(1, Self::MATCHES_PER_FOLD);
                        NewPlaceTerm { log_likelihood, temperature: tail.scale().max(1.0) }
                    }
                }
            }
        }
    }

    /// The method in use.
    #[must_use]
    pub fn method(&self) -> NewPlaceMethod {
        match self.stand_in {
            StandIn::AveragePlace(_) => NewPlaceMethod::MeanField,
            StandIn::Samples(_, Summary::Mean) => NewPlaceMethod::Sampled,
            StandIn::Samples(_, Summary::Tail) => NewPlaceMethod::Tail,
            StandIn::Samples(_, Summary::TemperedTail) => NewPlaceMethod::TemperedTail,
        }
    }
}

/// ln [(1/n) Σ exp(x)] of n values.
fn log_mean_exp(values: &[f64]) -> f64 {
    log_sum_exp(values) - (values.len() as f64).ln()
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
mod tests;
