//! How much the words not yet looked at may still add: Bennett's inequality (Bennett, "Probability
//! Inequalities for the Sum of Independent Random Variables", JASA 1962).

use super::WordTerm;
use crate::observation::WordId;

/// The sum of the words not yet looked at, over the places of the map: independent terms, of which
/// one is its word's gain at the share of places that have the word, and 0 at the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Remainder {
    mean: f64,
    variance: f64,
    /// What no term exceeds, without sign.
    largest: f64,
}

impl Remainder {
    /// The remainder after every `step` of the terms.
    pub(super) fn after_each(
        terms: &[WordTerm],
        share_with: impl Fn(WordId) -> f64,
        step: usize,
    ) -> Vec<Self> {
        let mut remainder = Self::default();
        let mut remainders: Vec<Self> = Vec::with_capacity(terms.len() / step + 1);
        for block in terms.chunks(step).rev() {
            remainders.push(remainder);
            block.iter().for_each(|term| remainder.add(term, share_with(term.word)));
        }
        remainders.reverse();
        remainders
    }

    fn add(&mut self, term: &WordTerm, share: f64) {
        self.mean += share * term.typical;
        self.variance += term.largest * term.largest * share * (1.0 - share);
        self.largest = self.largest.max(term.largest);
    }

    /// Raises the variance to that of the remainders of some places, or what it may be if they are
    /// few.
    pub(super) fn vary_as(&mut self, sample: &[f64]) {
        let count = sample.len() as f64;
        if count < 2.0 {
            return;
        }
        let mean = sample.iter().sum::<f64>() / count;
        let variance = sample.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        // Three standard deviations of the variance of a sample from a normal distribution.
        let may_be = variance * (1.0 + 3.0 * (2.0 / (count - 1.0)).sqrt());
        self.variance = self.variance.max(may_be);
    }

    /// ln of the mean of e^R over places, R taken to be normal: a sum of many terms. Where R varies
    /// so much that the mean is made by places that a map does not have, what none of its places
    /// exceeds but with the chance `risk` of each.
    pub(super) fn log_of_mean_likelihood(&self, risk: f64) -> f64 {
        self.mean + (0.5 * self.variance).min(exceeded_with(risk, self.variance, self.largest))
    }

    /// What the difference of two places' remainders exceeds with at most the chance `risk`: its
    /// mean is 0, its variance twice that of one.
    pub(super) fn overtaking_margin(&self, risk: f64) -> f64 {
        exceeded_with(risk, 2.0 * self.variance, self.largest)
    }
}

/// The Δ for which Bennett's inequality, P(S ≥ Δ) ≤ exp[-(V / M²) h(Δ M / V)] with h(u) = (1 + u)
/// ln(1 + u) - u, comes to `risk`; or a little more.
fn exceeded_with(risk: f64, variance: f64, largest: f64) -> f64 {
    if variance <= 0.0 {
        return 0.0;
    }
    let level = -risk.ln() * largest * largest / variance;
    // Bernstein's bound of h is solved in closed form, from above; h is convex, so Newton's steps
    // stay above.
    let mut u = level / 3.0 + (level * level / 9.0 + 2.0 * level).sqrt();
    for _ in 0..3 {
        let log = u.ln_1p();
        u -= ((1.0 + u) * log - u - level) / log;
    }
    u * variance / largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn margins_solve_the_inequality(risk in 1e-12..0.5f64, variance in 1e-3..1e4f64, largest in 0.01..30.0f64) {
            let margin = exceeded_with(risk, variance, largest);
            let u = margin * largest / variance;
            let chance = (-(variance / (largest * largest)) * ((1.0 + u) * u.ln_1p() - u)).exp();
            prop_assert!(chance <= risk * (1.0 + 1e-9), "{chance} {risk}");
            prop_assert!(chance >= 0.9 * risk, "{chance} {risk}");
        }
    }

    #[test]
    fn nothing_left_adds_nothing() {
        assert_eq!(Remainder::default().overtaking_margin(1e-6), 0.0);
        assert!(Remainder::after_each(&[], |_| 0.5, 16).is_empty());
    }
}
