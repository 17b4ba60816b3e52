//! How likely the likeliest of many unrelated places is: the tail of a sample of them, extended.

/// The upper tail of log-likelihoods of places that have nothing to do with the observation.
///
/// Above a high threshold t the tail of almost any distribution is a generalised Pareto one
/// (Pickands 1975). A log-likelihood is a sum over many words, whose tail falls off as an
/// exponential or faster: P(ln p(Z | L) > t + x) = share · exp(-x / scale), or less. The mean
/// excess is the maximum-likelihood scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tail {
    threshold: f64,
    /// Fraction of places above the threshold.
    share: f64,
    /// Nats in which the tail falls by a factor e; 0 if there are too few samples to tell.
    scale: f64,
}

impl Tail {
    /// Share of the samples that the tail is fitted to: few enough to be a tail, enough of a
    /// thousand for its scale.
    const SHARE: f64 = 0.05;
    /// Of fewer samples the tail is so many, but no more than a quarter: a scale found from less
    /// errs by more than a fifth.
    const FEWEST: usize = 25;

    /// Fits the tail to samples of at least one place, in any order; reorders them.
    pub(super) fn fit(log_likelihoods: &mut [f64]) -> Self {
        let samples = log_likelihoods.len();
        let fewest = Self::FEWEST.min(samples / 4);
        let above = ((samples as f64 * Self::SHARE).ceil() as usize).max(fewest).min(samples - 1);
        let (above, threshold, _) = log_likelihoods.select_nth_unstable_by(above, |a, b| b.total_cmp(a));
        // Summed in order, so that the same samples give the same bits.
        above.sort_unstable_by(f64::total_cmp);
        let excess: f64 = above.iter().map(|value| value - *threshold).sum();
        let scale = if above.is_empty() { 0.0 } else { excess / above.len() as f64 };
        Self { threshold: *threshold, share: above.len().max(1) as f64 / samples as f64, scale }
    }

    /// Nats in which the tail falls by a factor e.
    pub(super) fn scale(&self) -> f64 {
        self.scale
    }

    /// The log-likelihood y that the likeliest of `places` unrelated places exceeds with a
    /// probability of at most `rate`: places · P(ln p(Z | L) > y) = rate.
    pub(super) fn exceeded_by_best_of(&self, places: usize, rate: f64) -> f64 {
        self.threshold + self.scale * (places as f64 * self.share / rate).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The same fit written plainly.
        #[test]
        fn the_tail_is_the_mean_excess_of_the_top(values in proptest::collection::vec(-900.0..-100.0f64, 500..900)) {
            let mut sorted = values.clone();
            sorted.sort_by(|a, b| b.total_cmp(a));
            let above = (values.len() as f64 / 20.0).ceil() as usize;
            let scale = sorted[..above].iter().sum::<f64>() / above as f64 - sorted[above];
            let share = above as f64 / values.len() as f64;
            let tail = Tail::fit(&mut values.clone());
            prop_assert_eq!((tail.threshold, tail.share), (sorted[above], share));
            prop_assert!((tail.scale - scale).abs() < 1e-9);
            let level = tail.exceeded_by_best_of(1000, 0.01);
            prop_assert!((1000.0 * share * (-(level - sorted[above]) / tail.scale).exp() - 0.01).abs() < 1e-9);
        }

        #[test]
        fn order_does_not_matter(values in proptest::collection::vec(-900.0..-100.0f64, 1..200)) {
            let mut reversed: Vec<f64> = values.iter().rev().copied().collect();
            prop_assert_eq!(Tail::fit(&mut values.clone()), Tail::fit(&mut reversed));
        }
    }

    #[test]
    fn an_exponential_tail_is_found() {
        // Quantiles of an exponential distribution of scale 7.
        let mut values: Vec<f64> = (0..10_000).map(|i| -7.0 * ((f64::from(i) + 0.5) / 1e4).ln()).collect();
        let tail = Tail::fit(&mut values);
        assert!((tail.scale - 7.0).abs() < 0.05, "{tail:?}");
        let level = tail.exceeded_by_best_of(1_000_000, 0.01);
        assert!((level - 7.0 * 1e8f64.ln()).abs() < 1.0, "{level}");
    }

    #[test]
    fn of_few_samples_more_are_the_tail() {
        let share = |samples: u32| Tail::fit(&mut (0..samples).map(f64::from).collect::<Vec<_>>()).share;
        assert_eq!([1, 2, 10, 60, 200, 2000].map(share), [1.0, 0.5, 0.2, 0.25, 0.125, 0.05]);
    }

    #[test]
    fn one_sample_has_no_spread() {
        let tail = Tail::fit(&mut [-300.0]);
        assert_eq!(tail.exceeded_by_best_of(1000, 0.01), -300.0);
    }
}
