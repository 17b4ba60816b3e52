//! FAB-MAP's likelihood alone: every earlier frame a place of its own, no map, no motion, no filter.

use std::collections::VecDeque;

use anyhow::Result;
use fabmap::PlaceId;
use fabmap::appearance::Appearance;
use fabmap::calibration::EvidenceExponent;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::place_filter::MotionPrior;
use fabmap::recognizer::{Recognition, Recognizer, RecognizerSettings};

use super::{Proposal, Ranked, Ranking};
use crate::error::refused;
use crate::observing::Observed;
use crate::timing::FrameWatch;

/// Ranks earlier frames by what the observation alone says of them.
///
/// To be compared with tf-idf, which sees the same words and as little of time. The model's likelihoods
/// are taken in full: the exponent that calibrates them is left out, for it keeps the order of a frame's
/// places; it would change the order among frames, and posteriors here are not calibrated.
#[derive(Clone, Debug)]
pub(crate) struct LikelihoodRanking {
    recognizer: Recognizer,
    /// Frames that are too near to be proposed yet, oldest first.
    waiting: VecDeque<Observation>,
    gap: usize,
}

impl LikelihoodRanking {
    /// Frames closer than `gap`, at least 1, are not proposed.
    pub(crate) fn new(model: &Model, settings: RecognizerSettings, gap: usize) -> Result<Self> {
        let plain = model.recalibrated(*model.detector(), EvidenceExponent::NONE);
        let recognizer = Recognizer::new(&plain, settings).map_err(refused)?;
        Ok(Self { recognizer, waiting: VecDeque::new(), gap })
    }
}

impl Ranking for LikelihoodRanking {
    fn rank(&mut self, index: usize, seen: Observed, mut watch: FrameWatch) -> Result<Ranked> {
        let Observed { observation, features: _ } = seen;
        if self.waiting.len() == self.gap
            && let Some(far_enough) = self.waiting.pop_front()
        {
            self.recognizer.add_place(&Appearance::of(&far_enough));
        }
        let recognition = self.recognizer.recognize_observed(&observation, &MotionPrior::even(), &mut watch);
        let words = observation.len();
        self.waiting.push_back(observation);
        let mut similarities = recognition.posterior.places.clone();
        similarities.resize(index, 0.0);
        Ok(Ranked {
            words,
            proposal: best(&recognition),
            decision: None,
            candidates: Vec::new(),
            times: watch.stop(),
            similarities,
        })
    }

    fn places(&self) -> Option<usize> {
        None
    }
}

/// The most probable frame, the earliest of equal ones. Found by likelihood: posteriors that round to 0
/// are all equal.
fn best(recognition: &Recognition) -> Option<Proposal> {
    let Recognition { log_likelihoods, new_place_log_likelihood, prior, posterior } = recognition;
    let joint =
        |place: usize| log_likelihoods[place] + prior.of(PlaceId::new(place as u32)).unwrap_or(0.0).ln();
    let best = (0..log_likelihoods.len())
        .reduce(|best, place| if joint(place) > joint(best) { place } else { best })?;
    let others = (0..log_likelihoods.len()).filter(|&place| place != best).map(joint);
    let others: Vec<f64> = others.chain([new_place_log_likelihood + prior.new_place().ln()]).collect();
    let score = joint(best) - log_sum_exp(&others);
    let posterior = Some(posterior.places[best]);
    Some(Proposal { frame: best, score, posterior, probability: posterior })
}

/// ln Σ exp(x) of at least one value.
fn log_sum_exp(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + values.iter().map(|value| (value - largest).exp()).sum::<f64>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fabmap::place_filter::{FilterSettings, PlaceDistribution, PlaceFilter, PlacePrior};

    /// 0.4 for a new place.
    fn even_prior(places: usize) -> PlacePrior {
        let settings = FilterSettings { new_place_prior: 0.4, ..FilterSettings::default() };
        PlaceFilter::new(settings).unwrap().prior(&MotionPrior::even(), places)
    }

    #[test]
    fn log_odds_are_those_of_the_posterior() {
        let recognition = Recognition {
            log_likelihoods: vec![-10.0, -8.0, -8.0],
            new_place_log_likelihood: -9.0,
            prior: even_prior(3),
            posterior: PlaceDistribution { places: vec![0.1, 0.3, 0.3], new_place: 0.3 },
        };
        let Proposal { frame, score, posterior, probability: _ } = best(&recognition).unwrap();
        let joint: [f64; 4] =
            [0.2 * (-10f64).exp(), 0.2 * (-8f64).exp(), 0.2 * (-8f64).exp(), 0.4 * (-9f64).exp()];
        let right = (joint[1] / (joint[0] + joint[2] + joint[3])).ln();
        assert_eq!((frame, posterior), (1, Some(0.3)));
        assert!((score - right).abs() < 1e-12, "{score} {right}");
    }

    #[test]
    fn likelihoods_that_round_to_nothing_are_still_told_apart() {
        let recognition = Recognition {
            log_likelihoods: vec![-9000.0, -8000.0],
            new_place_log_likelihood: -1000.0,
            prior: even_prior(2),
            posterior: PlaceDistribution { places: vec![0.0, 0.0], new_place: 1.0 },
        };
        let Proposal { frame, score, .. } = best(&recognition).unwrap();
        assert_eq!(frame, 1);
        assert!((score + 7000.0).abs() < 1.0);
    }
}
