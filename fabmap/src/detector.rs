//! How reliably a scene element shows as a word.

/// The detector model: how often a scene element that exists is seen as its word, and how often
/// a word is seen though its element does not exist. The same for every word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorModel {
    true_positive_rate: f64,
    false_positive_rate: f64,
}

/// Why a pair of rates is not a detector model.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DetectorError {
    /// The true positive rate p(z=1|e=1) is not strictly between 0 and 1.
    #[error("the true positive rate p(z=1|e=1) must lie between 0 and 1, not {rate}; 0.39 is a good start")]
    TruePositiveRate {
        /// The rate given.
        rate: f64,
    },
    /// The false positive rate p(z=1|e=0) is negative, or does not lie below the true one.
    #[error(
        "the false positive rate p(z=1|e=0) must be at least 0 and below the true positive rate \
         {true_positive_rate}, not {rate}; 0.01 is a good start"
    )]
    FalsePositiveRate {
        /// The rate given.
        rate: f64,
        /// The true positive rate beside it.
        true_positive_rate: f64,
    },
}

impl DetectorModel {
    /// How far the true positive rate must stay from 0 and 1: fifteen looks to its power are then
    /// still numbers.
    const MARGIN: f64 = 1e-6;

    /// `true_positive_rate` = p(z=1|e=1) in (0, 1); `false_positive_rate` = p(z=1|e=0) in
    /// [0, true_positive_rate). With a false positive rate of 0, as in the papers, a word once seen
    /// at a place is believed for ever.
    ///
    /// # Errors
    /// [`DetectorError`] if a rate is out of range or not a number.
    pub fn new(true_positive_rate: f64, false_positive_rate: f64) -> Result<Self, DetectorError> {
        if !(Self::MARGIN..=1.0 - Self::MARGIN).contains(&true_positive_rate) {
            return Err(DetectorError::TruePositiveRate { rate: true_positive_rate });
        }
        if !(0.0..true_positive_rate).contains(&false_positive_rate) {
            return Err(DetectorError::FalsePositiveRate { rate: false_positive_rate, true_positive_rate });
        }
        Ok(Self { true_positive_rate, false_positive_rate })
    }

    /// p(z = `seen` | e = `exists`).
    #[must_use]
    pub fn probability(&self, seen: bool, exists: bool) -> f64 {
        let rate = if exists { self.true_positive_rate } else { self.false_positive_rate };
        if seen { rate } else { 1.0 - rate }
    }

    /// p(e = 1 | seen in `hits` of `looks`), starting from the element's `marginal` in (0, 1):
    /// each look multiplies the odds by p(z|e=1)/p(z|e=0). Cummins & Newman 2008, eq. (19), with
    /// the naive detector for every look.
    #[must_use]
    pub fn belief(&self, marginal: f64, hits: u8, looks: u8) -> f64 {
        let (hits, misses) = (i32::from(hits), i32::from(looks) - i32::from(hits));
        let of_state =
            |exists| self.probability(true, exists).powi(hits) * self.probability(false, exists).powi(misses);
        let exists = marginal * of_state(true);
        exists / (exists + (1.0 - marginal) * of_state(false))
    }

    /// p(seen in `hits` of `looks` | e = 1) and the same for e = 0, over the larger of the two, so
    /// that many looks are no matter of tiny numbers.
    pub(crate) fn evidence(&self, hits: u8, looks: u8) -> [f64; 2] {
        let (hits, misses) = (i32::from(hits), i32::from(looks) - i32::from(hits));
        let of_state =
            |exists| self.probability(true, exists).powi(hits) * self.probability(false, exists).powi(misses);
        let (exists, does_not) = (of_state(true), of_state(false));
        let larger = exists.max(does_not);
        [exists / larger, does_not / larger]
    }
}

impl Default for DetectorModel {
    /// p(z=1|e=1) = 0.39 as published; p(z=1|e=0) = 0.01, so that a place can unlearn a word.
    fn default() -> Self {
        Self { true_positive_rate: 0.39, false_positive_rate: 0.01 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn closed_form_belief_is_the_recursive_bayes_update(
            a in 0.05..0.95f64, ratio in 0.0..0.9f64, marginal in 0.001..0.999f64, seen in proptest::collection::vec(any::<bool>(), 0..=15),
        ) {
            let detector = DetectorModel::new(a, a * ratio).unwrap();
            // Both masses are carried: near certainty, 1 - belief would keep too few digits to come back from.
            let (mut exists, mut absent) = (marginal, 1.0 - marginal);
            for &z in &seen {
                exists *= detector.probability(z, true);
                absent *= detector.probability(z, false);
                let total = exists + absent;
                (exists, absent) = (exists / total, absent / total);
            }
            let hits = seen.iter().filter(|&&z| z).count() as u8;
            prop_assert!((detector.belief(marginal, hits, seen.len() as u8) - exists).abs() < 1e-12);
        }
    }

    #[test]
    fn without_false_positives_one_look_is_certain_for_ever() {
        let paper = DetectorModel::new(0.39, 0.0).unwrap();
        assert_eq!(paper.belief(0.01, 1, 15), 1.0);
        assert!((paper.belief(0.2, 0, 1) - 0.61 * 0.2 / (1.0 - 0.39 * 0.2)).abs() < 1e-15);
    }

    #[test]
    fn rates_out_of_range_are_refused() {
        for rate in [0.0, 1.0, -0.1, f64::NAN, f64::INFINITY] {
            assert!(matches!(DetectorModel::new(rate, 0.0), Err(DetectorError::TruePositiveRate { .. })));
        }
        for rate in [0.39, 0.5, -0.1, f64::NAN] {
            assert!(matches!(DetectorModel::new(0.39, rate), Err(DetectorError::FalsePositiveRate { .. })));
        }
    }
}
