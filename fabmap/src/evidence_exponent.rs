//! How far likelihoods count: less than in full, because words depend on each other beyond the
//! tree.

/// What every likelihood is raised to, in (0, 1]: the share of a word's evidence that is news
/// beside the other words.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct EvidenceExponent(f64);

/// A number that is not an exponent of evidence.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the exponent of the evidence must be above 0 and at most 1, not {value}; 1 takes words as independent"
)]
pub struct EvidenceExponentError {
    /// The number given.
    pub value: f64,
}

impl EvidenceExponent {
    /// 1: likelihoods as they are.
    pub const NONE: Self = Self(1.0);

    /// # Errors
    /// [`EvidenceExponentError`] if `value` is not in (0, 1].
    pub fn new(value: f64) -> Result<Self, EvidenceExponentError> {
        if value > 0.0 && value <= 1.0 { Ok(Self(value)) } else { Err(EvidenceExponentError { value }) }
    }

    /// The exponent.
    #[must_use]
    pub fn value(self) -> f64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_exponent_is_refused() {
        assert_eq!(EvidenceExponent::new(1.0), Ok(EvidenceExponent::NONE));
        for value in [0.0, -0.5, 1.1, f64::NAN, f64::INFINITY] {
            assert!(EvidenceExponent::new(value).is_err(), "{value}");
        }
    }
}
