//! Whether two ways to measure the same thing agree.

/// How many times as much one of two says as the other, over several measurements of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Measurements that were compared.
    pub compared: usize,
    /// The median of one per other; 1 where they agree.
    pub ratio: f64,
    /// Four of five measurements are within this of the median.
    pub spread: f64,
}

/// What an [`Agreement`] comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AgreementVerdict {
    /// Both say the same.
    Alike,
    /// One says steadily more, or steadily less.
    OfAnotherScale,
    /// One says now more, now less: they are not of the same moments.
    OutOfStep,
}

impl Agreement {
    /// Measurements that are too few to be judged by.
    const LEAST: usize = 5;

    /// Nearer to 1 than this both agree: wheels that are off by as much are common.
    const TOLERANCE: f64 = 0.15;

    /// Of a spread beyond this there is no common scale.
    const MAX_SPREAD: f64 = 0.3;

    /// Of measurements, each as one per other; `None` if they are too few.
    #[must_use]
    pub fn of(ratios: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut ratios: Vec<f64> = ratios.into_iter().collect();
        if ratios.len() < Self::LEAST {
            return None;
        }
        let ratio = median(&mut ratios)?;
        let mut off: Vec<f64> = ratios.iter().map(|one| (one - ratio).abs()).collect();
        let four_of_five = (4 * off.len() - 1) / 5;
        let spread = *off.select_nth_unstable_by(four_of_five, f64::total_cmp).1;
        Some(Self { compared: ratios.len(), ratio, spread })
    }

    /// Whether that is as it should be.
    #[must_use]
    pub fn verdict(&self) -> AgreementVerdict {
        if self.spread > Self::MAX_SPREAD {
            AgreementVerdict::OutOfStep
        } else if (self.ratio - 1.0).abs() > Self::TOLERANCE {
            AgreementVerdict::OfAnotherScale
        } else {
            AgreementVerdict::Alike
        }
    }
}

/// The one in the middle; the greater one if two are. `None` of none. The order of `values` changes.
#[must_use]
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(ratios: [f64; 6]) -> AgreementVerdict {
        Agreement::of(ratios).unwrap().verdict()
    }

    #[test]
    fn one_measurement_that_is_off_decides_nothing() {
        assert_eq!(verdict([1.0, 1.1, 0.9, 1.0, 7.0, 1.05]), AgreementVerdict::Alike);
        assert_eq!(verdict([1.3, 1.35, 1.25, 1.3, 1.1, -4.0]), AgreementVerdict::OfAnotherScale);
        assert_eq!(verdict([0.2, 1.9, 1.0, 0.4, 1.7, -0.6]), AgreementVerdict::OutOfStep);
    }

    #[test]
    fn few_measurements_are_not_judged() {
        assert_eq!(Agreement::of([2.0; 4]), None);
        assert_eq!(Agreement::of([2.0; 5]), Some(Agreement { compared: 5, ratio: 2.0, spread: 0.0 }));
    }
}
