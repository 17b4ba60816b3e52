use std::ops::ControlFlow;
use std::sync::Arc;

use rayon::prelude::*;

use super::pairs;
use crate::appearance::Appearance;
use crate::detector::DetectorModel;
use crate::evidence_exponent::EvidenceExponent;
use crate::inverted_index::InvertedIndex;
use crate::likelihood::{Dependence, ObservationModel};
use crate::model::Model;
use crate::new_place::log_sum_exp;

/// Which rates the calibration is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rates {
    /// These; only the exponent is learnt.
    Fixed(DetectorModel),
    /// The best of some pairs of rates.
    Learned,
}

/// What was learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// p(z|e).
    pub detector: DetectorModel,
    /// What likelihoods are to be raised to.
    pub exponent: EvidenceExponent,
    /// Pairs of overlapping training images that it was learnt from.
    pub pairs: usize,
    /// Mean of -ln p(what is right) over the staged revisits and new places, in nats.
    pub loss_nats: f64,
}

/// Why nothing was learnt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LearnError {
    /// Too few overlapping neighbours.
    #[error(
        "only {found} of the model's training images overlap the one before, and {MIN_PAIRS} are needed to learn how \
         reliable words are; train on images in order of time, close enough together to overlap, or keep fixed rates"
    )]
    TooFewPairs {
        /// How many do.
        found: usize,
    },
    /// The observer asked to stop.
    #[error("learning was cancelled")]
    Cancelled,
}

/// p(z=1|e=1) that are tried.
const TRUE_POSITIVE_RATES: [f64; 8] = [0.1, 0.15, 0.2, 0.25, 0.3, 0.39, 0.5, 0.6];

/// p(z=1|e=0) that are tried.
const FALSE_POSITIVE_RATES: [f64; 6] = [0.001, 0.003, 0.01, 0.02, 0.03, 0.05];

/// Fewer pairs than this say too little.
const MIN_PAIRS: usize = 50;

/// Most pairs that are used; time grows with them.
const MAX_PAIRS: usize = 200;

/// Samples nearer than this to a query, in the order of the images, may show its place too, and are
/// neither on the staged map nor samples of other places.
const NEAR_SAMPLES: usize = 30;

/// The model with the rates and the exponent that its own training images teach, and what was
/// learnt; with what was learnt from other images, and `None`, if too few of its own overlap.
/// `observer` as for [`learn`]; it breaks off what it cancels.
pub fn calibrate(
    model: &Model,
    observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> ControlFlow<(), (Model, Option<Calibration>)> {
    match learn(model, Rates::Learned, observer) {
        Ok(learnt) => {
            ControlFlow::Continue((model.recalibrated(learnt.detector, learnt.exponent), Some(learnt)))
        }
        Err(LearnError::TooFewPairs { found: _ }) => {
            let (detector, exponent) = typical();
            ControlFlow::Continue((model.recalibrated(detector, exponent), None))
        }
        Err(LearnError::Cancelled) => ControlFlow::Break(()),
    }
}

/// What is learnt for 5,000 RootSIFT words of office floors; streets give nearly the same.
fn typical() -> (DetectorModel, EvidenceExponent) {
    let detector = DetectorModel::new(0.25, 0.01).unwrap_or_default();
    (detector, EvidenceExponent::new(0.12).unwrap_or(EvidenceExponent::NONE))
}

/// Learns how far the likelihoods of `model` can be trusted, from its sampling set, which has to be
/// in order of time as training makes it. `observer` is called with the fraction done, in [0, 1],
/// and may cancel.
///
/// # Errors
/// [`LearnError`].
pub fn learn(
    model: &Model,
    rates: Rates,
    observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Calibration, LearnError> {
    let pairs = pairs::overlapping(model.sampling_set(), model.vocabulary().len(), MAX_PAIRS);
    if pairs.len() < MIN_PAIRS {
        return Err(LearnError::TooFewPairs { found: pairs.len() });
    }
    let candidates = rates.candidates();
    let mut best: Option<Calibration> = None;
    for (done, &detector) in candidates.iter().enumerate() {
        if observer(done as f64 / candidates.len() as f64).is_break() {
            return Err(LearnError::Cancelled);
        }
        let trials = trials(model, detector, &pairs);
        let (exponent, loss_nats) = best_exponent(&trials);
        if best.is_none_or(|best| loss_nats < best.loss_nats) {
            best = Some(Calibration { detector, exponent, pairs: pairs.len(), loss_nats });
        }
    }
    best.ok_or(LearnError::TooFewPairs { found: 0 })
}

impl Rates {
    fn candidates(self) -> Vec<DetectorModel> {
        let grid = || {
            TRUE_POSITIVE_RATES.iter().flat_map(|&seen| {
                FALSE_POSITIVE_RATES
                    .iter()
                    .filter_map(move |&mistaken| DetectorModel::new(seen, mistaken).ok())
            })
        };
        match self {
            Self::Fixed(detector) => vec![detector],
            Self::Learned => grid().collect(),
        }
    }
}

/// One training image as a query: plain ln p(Z | ·) of what it is compared with.
#[derive(Clone, Debug, PartialEq)]
struct Trial {
    /// The place that it shows: its overlapping neighbour.
    same_place: f64,
    /// The other places of the staged map: every other far sample.
    other_places: Vec<f64>,
    /// The samples of places that are not on it: the rest of the far ones.
    elsewhere: Vec<f64>,
}

/// Every query twice: against places looked at once, and against places that also have the look
/// before it, as places of a map do. The samples of other places are single looks either way, as in
/// the new-place term.
fn trials(model: &Model, detector: DetectorModel, pairs: &[(usize, usize)]) -> Vec<Trial> {
    let samples = model.sampling_set();
    let observation_model = Arc::new(ObservationModel::new(model.tree(), detector, Dependence::ChowLiu));
    let mut seen_once = InvertedIndex::new(observation_model.clone());
    let mut seen_twice = InvertedIndex::new(observation_model);
    for (sample, before) in samples.iter().zip(samples.iter().take(1).chain(samples)) {
        seen_once.add(&Appearance::of(sample));
        let mut twice = Appearance::of(before);
        twice.observe(sample);
        seen_twice.add(&twice);
    }
    let trials_of = |&(earlier, later): &(usize, usize)| {
        let once = seen_once.log_likelihoods(&samples[later]);
        let twice = seen_twice.log_likelihoods(&samples[later]);
        let far = (0..samples.len()).filter(|&sample| sample.abs_diff(later) > NEAR_SAMPLES);
        let (on_map, off_map): (Vec<usize>, Vec<usize>) = far.partition(|sample| sample % 2 == 0);
        let of = |scores: &[f64], samples: &[usize]| samples.iter().map(|&sample| scores[sample]).collect();
        [&once, &twice].map(|scores: &Vec<f64>| Trial {
            same_place: scores[earlier],
            other_places: of(scores, &on_map),
            elsewhere: of(&once, &off_map),
        })
    };
    pairs.par_iter().flat_map_iter(trials_of).collect()
}

impl Trial {
    /// -ln p(the right place) with the neighbour on the map, and -ln p(new) without it; in either
    /// case a new place is as probable beforehand as all known ones together, for so they are
    /// staged.
    fn losses_nats(&self, exponent: f64) -> [f64; 2] {
        let tempered = |scores: &[f64]| -> Vec<f64> { scores.iter().map(|score| exponent * score).collect() };
        let others = tempered(&self.other_places);
        let elsewhere = tempered(&self.elsewhere);
        let same = exponent * self.same_place;
        let known = log_sum_exp(&others);
        let new = log_sum_exp(&elsewhere) - (elsewhere.len() as f64).ln();
        let places = others.len() as f64;
        let revisit = log_sum_exp(&[same, known, new + (places + 1.0).ln()]) - same;
        let new = new + places.ln();
        [revisit, log_sum_exp(&[known, new]) - new]
    }
}

fn loss_nats(trials: &[Trial], exponent: f64) -> f64 {
    let losses: Vec<[f64; 2]> = trials.par_iter().map(|trial| trial.losses_nats(exponent)).collect();
    losses.iter().flatten().sum::<f64>() / (2 * losses.len()) as f64
}

/// The exponent of least loss, by golden section over its logarithm. The loss of a revisit is
/// convex in the exponent; that of a new place, whose own score is a mean over samples, need not
/// be.
fn best_exponent(trials: &[Trial]) -> (EvidenceExponent, f64) {
    const STEPS: usize = 16;
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    let loss = |ln_exponent: f64| loss_nats(trials, ln_exponent.exp());
    let (mut low, mut high) = (MIN_EXPONENT.ln(), 0.0);
    let mut inner = [high - golden * (high - low), low + golden * (high - low)];
    let mut losses = inner.map(loss);
    for _ in 0..STEPS {
        if losses[0] <= losses[1] {
            high = inner[1];
            inner = [high - golden * (high - low), inner[0]];
            losses = [loss(inner[0]), losses[0]];
        } else {
            low = inner[0];
            inner = [inner[1], low + golden * (high - low)];
            losses = [losses[1], loss(inner[1])];
        }
    }
    let value = ((low + high) / 2.0).exp();
    let exponent = EvidenceExponent::new(value).unwrap_or(EvidenceExponent::NONE);
    (exponent, loss_nats(trials, exponent.value()))
}

/// With less the evidence would count for nothing.
const MIN_EXPONENT: f64 = 0.005;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Scores that are `scale` times too far apart.
    fn staged(scale: f64, count: usize) -> Vec<Trial> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        // Log-likelihood ratios of two normals with means ±d²/2 and variance d² are calibrated.
        let d: f64 = 3.0;
        (0..count)
            .map(|_| {
                let mut score = |mean: f64| scale * (mean + d * normal());
                let mut others = |n: usize| (0..n).map(|_| score(-d * d / 2.0)).collect::<Vec<f64>>();
                let (other_places, elsewhere) = (others(40), others(40));
                Trial { same_place: score(d * d / 2.0), other_places, elsewhere }
            })
            .collect()
    }

    #[test]
    fn scores_too_far_apart_are_drawn_together_by_as_much() {
        let (plain, loss) = best_exponent(&staged(1.0, 400));
        assert!(plain.value() > 0.75, "{plain:?}");
        for scale in [4.0, 20.0] {
            let (exponent, scaled_loss) = best_exponent(&staged(scale, 400));
            let ratio = exponent.value() * scale / plain.value();
            assert!((0.8..1.35).contains(&ratio), "{scale}: {exponent:?}");
            assert!(scaled_loss <= loss + 1e-6);
        }
    }

    #[test]
    fn the_losses_are_those_of_bayes_rule() {
        let trial = Trial { same_place: 2.0, other_places: vec![1.0, -1.0], elsewhere: vec![0.5, -2.0, 1.5] };
        let l = |score: f64| (0.5 * score).exp();
        let new = (l(0.5) + l(-2.0) + l(1.5)) / 3.0;
        let known = |scores: &[f64]| scores.iter().map(|&score| l(score)).sum::<f64>() / scores.len() as f64;
        let revisit = l(2.0) / 3.0 / (known(&[2.0, 1.0, -1.0]) + new);
        let [same, fresh] = trial.losses_nats(0.5);
        assert!((same + revisit.ln()).abs() < 1e-12);
        assert!((fresh + (new / (known(&[1.0, -1.0]) + new)).ln()).abs() < 1e-12);
    }
}
