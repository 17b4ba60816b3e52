//! Settings of the filter.

/// Settings of the filter; every value is checked by [`super::PlaceFilter::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterSettings {
    /// p(new): prior probability that the robot is at a place it has never seen, in (0, 1).
    pub new_place_prior: f64,
    /// ε: share of the rest that is spread evenly over all places, so that none is ruled out by the
    /// motion prior; in (0, 1].
    pub even_share: f64,
    /// σ: weight of the normalised likelihoods against an even distribution, in (0, 1]; 1, the
    /// default, leaves them as they are. Cummins & Newman 2008, eq. (18). Below 1 no single frame
    /// can be convincing, which spares wrong closures and also levels the evidence that ranks the
    /// right ones.
    pub likelihood_smoothing: f64,
}

impl Default for FilterSettings {
    fn default() -> Self {
        Self { new_place_prior: 0.9, even_share: 0.1, likelihood_smoothing: 1.0 }
    }
}

/// A setting of the filter is out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// p(new) out of range.
    #[error("the prior of a new place must lie between 0 and 1, not {value}; 0.9 is a good start")]
    NewPlacePrior {
        /// The value given.
        value: f64,
    },
    /// ε out of range.
    #[error("the even share must be above 0 and at most 1, not {value}; 0.1 is a good start")]
    EvenShare {
        /// The value given.
        value: f64,
    },
    /// σ out of range.
    #[error(
        "likelihood smoothing must be above 0 and at most 1, not {value}; 1 is none, 0.99 what the papers use"
    )]
    LikelihoodSmoothing {
        /// The value given.
        value: f64,
    },
}
