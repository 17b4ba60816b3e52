//! What one observation says about where the robot is.

use crate::appearance::PlaceId;
use crate::place_filter::{PlaceDistribution, PlacePrior};

/// What one observation says about where the robot is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recognition {
    /// ln p(Z | L_i) per place, in nats.
    pub log_likelihoods: Vec<f64>,
    /// ln p(Z | L_new), in nats.
    pub new_place_log_likelihood: f64,
    /// Before the observation.
    pub prior: PlacePrior,
    /// After it.
    pub posterior: PlaceDistribution,
}

/// Which place an observation belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Association {
    /// A place that is not on the map.
    New,
    /// A place that is.
    Seen(PlaceId),
}

impl Recognition {
    /// The largest of the posterior, "somewhere new" included; a known place wins a tie.
    #[must_use]
    pub fn association(&self) -> Association {
        match self.posterior.best_place() {
            Some((place, probability)) if probability >= self.posterior.new_place => Association::Seen(place),
            Some(_) | None => Association::New,
        }
    }
}
