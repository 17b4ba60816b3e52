//! Are reported probabilities what they say? Reliability and expected calibration error.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::dataset::Verdict;

/// Bins of a reliability diagram.
pub(crate) const BINS: usize = 10;

/// Predictions in [`BINS`] bins of equal mass, by probability: how sure the system was in each, and
/// how often it was right.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Reliability {
    /// The bins, least probable first; none without predictions.
    pub(crate) bins: Vec<ReliabilityBin>,
}

/// One bin of a reliability diagram.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct ReliabilityBin {
    /// Predictions in it.
    pub predictions: usize,
    /// Mean of the probabilities reported, in [0, 1].
    pub mean_probability: f64,
    /// Share of them that is right, in [0, 1]; predictions of equal probability are right as often as
    /// all of that probability are, so that their order does not matter.
    pub share_right: f64,
}

/// A reported probability with what the truth says of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prediction {
    /// That the prediction is right, as reported, in [0, 1].
    pub probability: f64,
    /// What the truth says; neutral ones are left out.
    pub verdict: Verdict,
}

impl Reliability {
    /// Bins the predictions; bins differ in size by at most one. With fewer predictions than bins there
    /// is one bin for each.
    pub(crate) fn of(predictions: &[Prediction]) -> Self {
        let judged = by_probability(predictions);
        let bins = judged.len().min(BINS);
        let border = |bin: usize| bin * judged.len() / bins;
        Self {
            bins: (0..bins).map(|bin| ReliabilityBin::of(&judged[border(bin)..border(bin + 1)])).collect(),
        }
    }

    /// Σ_b (n_b / n) |mean probability - share right|, in [0, 1]: Naeini, Cooper & Hauskrecht 2015, with
    /// bins of equal mass. `None` without predictions.
    pub(crate) fn expected_calibration_error(&self) -> Option<f64> {
        let all: usize = self.bins.iter().map(|bin| bin.predictions).sum();
        let weighted = |bin: &ReliabilityBin| {
            bin.predictions as f64 / all as f64 * (bin.mean_probability - bin.share_right).abs()
        };
        (all > 0).then(|| self.bins.iter().map(weighted).sum())
    }
}

/// Times that predictions are drawn anew for an interval.
const DRAWS: usize = 1000;

/// Where 95 % of the values of [`Reliability::expected_calibration_error`] lie when as many predictions are drawn anew
/// out of these: how much so few of them tell. Neighbours in a drive are alike, so that the truth is wider. The error
/// of few is above that of many, for the bins of few stray; so is the interval. `None` without predictions.
pub(crate) fn error_interval(predictions: &[Prediction]) -> Option<[f64; 2]> {
    let judged: Vec<Prediction> =
        predictions.iter().copied().filter(|one| one.verdict != Verdict::Neutral).collect();
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut draw = || {
        let drawn: Vec<Prediction> =
            judged.iter().map(|_| judged[random.random_range(0..judged.len())]).collect();
        Reliability::of(&drawn).expected_calibration_error()
    };
    let mut errors = (0..DRAWS).map(|_| draw()).collect::<Option<Vec<f64>>>()?;
    errors.sort_by(f64::total_cmp);
    Some([errors[DRAWS / 40], errors[DRAWS - 1 - DRAWS / 40]])
}

/// (probability, share right) of all that are not neutral, least probable first.
fn by_probability(predictions: &[Prediction]) -> Vec<(f64, f64)> {
    let right = |verdict: Verdict| match verdict {
        Verdict::True => Some(1.0),
        Verdict::False => Some(0.0),
        Verdict::Neutral => None,
    };
    let judged = predictions.iter();
    let mut judged: Vec<(f64, f64)> =
        judged.filter_map(|one| Some((one.probability, right(one.verdict)?))).collect();
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    for equal in judged.chunk_by_mut(|a, b| a.0 == b.0) {
        let share = equal.iter().map(|(_, right)| right).sum::<f64>() / equal.len() as f64;
        equal.iter_mut().for_each(|(_, right)| *right = share);
    }
    judged
}

impl ReliabilityBin {
    fn of(judged: &[(f64, f64)]) -> Self {
        let mean =
            |value: fn(&(f64, f64)) -> f64| judged.iter().map(value).sum::<f64>() / judged.len() as f64;
        Self {
            predictions: judged.len(),
            mean_probability: mean(|one| one.0),
            share_right: mean(|one| one.1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn predictions(of: &[(f64, Verdict)]) -> Vec<Prediction> {
        of.iter().map(|&(probability, verdict)| Prediction { probability, verdict }).collect()
    }

    fn error(of: &[(f64, Verdict)]) -> Option<f64> {
        Reliability::of(&predictions(of)).expected_calibration_error()
    }

    #[test]
    fn few_predictions_have_a_bin_each() {
        // |0.9 - 1| / 3 + |0.6 - 0| / 3 + |0.2 - 0| / 3, the neutral one left out.
        let few =
            [(0.9, Verdict::True), (0.6, Verdict::False), (0.99, Verdict::Neutral), (0.2, Verdict::False)];
        assert!((error(&few).unwrap() - 0.3).abs() < 1e-12);
        assert_eq!(error(&[]), None);
        assert_eq!(error(&[(0.5, Verdict::Neutral)]), None);
    }

    #[test]
    fn bins_have_equal_mass() {
        // Twenty predictions, two a bin: 0.00 and 0.05 wrong, ..., the upper ten right.
        let twenty: Vec<(f64, Verdict)> = (0..20)
            .map(|i| (f64::from(i) * 0.05, if i < 10 { Verdict::False } else { Verdict::True }))
            .collect();
        let reliability = Reliability::of(&predictions(&twenty));
        assert!(reliability.bins.iter().all(|bin| bin.predictions == 2));
        let ReliabilityBin { mean_probability, share_right, .. } = reliability.bins[5];
        assert!((mean_probability - 0.525).abs() < 1e-12 && share_right == 1.0);
        // Means 0.025, 0.125, ... 0.425 against 0, and 0.525, ... 0.925 against 1: 2 × (5 × 0.225 + 5 × 0.275) / 20.
        assert!((reliability.expected_calibration_error().unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn equal_probabilities_are_right_as_often_as_all_of_them() {
        // Nine in ten right at 0.9, in any order: calibrated, though no bin of ten is by itself.
        let mut hundred = vec![(0.9, Verdict::True); 90];
        hundred.extend([(0.9, Verdict::False); 10]);
        assert!(error(&hundred).unwrap() < 1e-12);
        hundred.reverse();
        assert!(error(&hundred).unwrap() < 1e-12);
    }

    #[test]
    fn an_interval_tells_how_little_few_tell() {
        // Right as often as said, in tens: of many the error is surely small, of few it may be large.
        let right = |i: usize| if i % 10 < 7 { Verdict::True } else { Verdict::False };
        let of = |count| predictions(&(0..count).map(|i| (0.7, right(i))).collect::<Vec<_>>());
        let [low, high] = error_interval(&of(2000)).unwrap();
        assert!(0.0 <= low && low < high && high < 0.03, "{low} {high}");
        let [_, of_few] = error_interval(&of(20)).unwrap();
        assert!(of_few > 0.1, "{of_few}");
        assert_eq!(error_interval(&predictions(&[(0.7, Verdict::Neutral)])), None);
    }

    #[test]
    fn the_sure_and_wrong_are_counted_in_full() {
        assert!((error(&[(1.0, Verdict::False); 30]).unwrap() - 1.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn the_order_of_predictions_does_not_matter(
            of in proptest::collection::vec((0..6u8, any::<bool>()), 1..60), seed in any::<prop::sample::Index>(),
        ) {
            let of: Vec<(f64, Verdict)> = of.into_iter()
                .map(|(p, right)| (f64::from(p) / 5.0, if right { Verdict::True } else { Verdict::False }))
                .collect();
            let mut turned = of.clone();
            turned.rotate_left(seed.index(of.len()));
            let (a, b) = (error(&of).unwrap(), error(&turned).unwrap());
            prop_assert!((a - b).abs() < 1e-12 && (0.0..=1.0).contains(&a));
        }
    }
}
