//! The weights of a closure's probability, fitted to proposals that were judged.

use nalgebra::{Matrix3, Vector3};
use topomap::evidence::ProbabilityWeights;

/// What speaks for a proposal, and whether it is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JudgedEvidence {
    /// Evidence of geometry, as a multiple of what the best look-alike is expected to show.
    pub(crate) look_alikes: f64,
    /// Log-odds by words.
    pub(crate) word_nats: f64,
    /// What the truth says.
    pub(crate) is_right: bool,
}

/// Weight of w² against the mean loss of a sequence: enough that the weights stay finite where the right are apart
/// from the wrong.
const RIDGE: f64 = 1e-4;

/// Words count in tens of nats while fitting, so that all three weights are of one size.
const WORD_SCALE_NATS: f64 = 10.0;

/// Newton's method has converged long before, from any sequence seen.
const STEPS: usize = 100;

/// Logistic regression: the weights that make what is judged most likely. Each sequence counts alike, however many
/// proposals it has; one without any does not count.
pub(crate) fn fit(sequences: &[&[JudgedEvidence]]) -> ProbabilityWeights {
    let mut weights = Vector3::zeros();
    for _ in 0..STEPS {
        let (gradient, curvature) = slope(sequences, &weights);
        let Some(step) = curvature.cholesky().map(|curvature| curvature.solve(&gradient)) else { break };
        weights -= shortened(sequences, &weights, step);
        if step.norm() < 1e-9 {
            break;
        }
    }
    let [offset_nats, per_look_alike_nats, per_ten_word_nats] = weights.into();
    ProbabilityWeights { offset_nats, per_look_alike_nats, per_word_nat: per_ten_word_nats / WORD_SCALE_NATS }
}

/// Half the step, and half of that, until the loss does not rise.
fn shortened(sequences: &[&[JudgedEvidence]], weights: &Vector3<f64>, step: Vector3<f64>) -> Vector3<f64> {
    let before = loss(sequences, weights);
    let mut step = step;
    for _ in 0..STEPS {
        if loss(sequences, &(weights - step)) <= before {
            return step;
        }
        step /= 2.0;
    }
    Vector3::zeros()
}

/// Σ_s mean_i -ln p(is right, or not) + ridge · w².
fn loss(sequences: &[&[JudgedEvidence]], weights: &Vector3<f64>) -> f64 {
    let of_one = |one: &JudgedEvidence| {
        let log_odds = weights.dot(&one.features());
        let against = if one.is_right { -log_odds } else { log_odds };
        against.max(0.0) + (-against.abs()).exp().ln_1p()
    };
    let of_all = |all: &&[JudgedEvidence]| all.iter().map(of_one).sum::<f64>() / all.len().max(1) as f64;
    sequences.iter().map(of_all).sum::<f64>() + RIDGE * weights.norm_squared()
}

/// First and second derivative of [`loss`].
fn slope(sequences: &[&[JudgedEvidence]], weights: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
    let mut gradient = weights * (2.0 * RIDGE);
    let mut curvature = Matrix3::identity() * (2.0 * RIDGE);
    for all in sequences {
        let share = 1.0 / all.len().max(1) as f64;
        for one in *all {
            let features = one.features();
            let probability = 1.0 / (1.0 + (-weights.dot(&features)).exp());
            let right = if one.is_right { 1.0 } else { 0.0 };
            gradient += features * (share * (probability - right));
            curvature += features * features.transpose() * (share * probability * (1.0 - probability));
        }
    }
    (gradient, curvature)
}

impl JudgedEvidence {
    fn features(&self) -> Vector3<f64> {
        let words = self.word_nats.max(ProbabilityWeights::LEAST_WORD_NATS) / WORD_SCALE_NATS;
        Vector3::new(1.0, self.look_alikes, words)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn weights_that_made_the_truth_are_found_again() {
        let made_by = ProbabilityWeights { offset_nats: -2.0, per_look_alike_nats: 1.5, per_word_nat: 0.2 };
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut judged = |_| {
            let (look_alikes, word_nats) = (random.random_range(0.0..4.0), random.random_range(-30.0..10.0));
            let log_odds = made_by.contributions(look_alikes, 1.0, word_nats).log_odds_nats();
            let is_right = random.random_bool(1.0 / (1.0 + (-log_odds).exp()));
            JudgedEvidence { look_alikes, word_nats, is_right }
        };
        let (one, other): (Vec<_>, Vec<_>) =
            ((0..20_000).map(&mut judged).collect(), (0..5_000).map(judged).collect());
        let found = fit(&[&one, &other]);
        assert!((found.offset_nats - made_by.offset_nats).abs() < 0.15, "{found:?}");
        assert!((found.per_look_alike_nats - made_by.per_look_alike_nats).abs() < 0.1, "{found:?}");
        assert!((found.per_word_nat - made_by.per_word_nat).abs() < 0.02, "{found:?}");
        // A sequence without proposals changes nothing.
        assert_eq!(fit(&[&one, &other, &[]]), found);
    }

    #[test]
    fn what_is_apart_is_told_apart_by_finite_weights() {
        let judged = |look_alikes, is_right| JudgedEvidence { look_alikes, word_nats: 0.0, is_right };
        let all = [judged(0.5, false), judged(1.0, false), judged(3.0, true), judged(8.0, true)];
        let found = fit(&[&all]);
        let probability =
            |look_alikes| 1.0 / (1.0 + (-found.contributions(look_alikes, 1.0, 0.0).log_odds_nats()).exp());
        assert!(found.per_look_alike_nats.is_finite() && found.per_look_alike_nats > 1.0, "{found:?}");
        assert!(probability(1.0) < 0.1 && probability(3.0) > 0.9, "{found:?}");
        let none = fit(&[]);
        assert_eq!((none.offset_nats, none.per_look_alike_nats, none.per_word_nat), (0.0, 0.0, 0.0));
    }
}
