//! What a frame shows.

use std::sync::Arc;
use std::time::Duration;

use fabmap::observation::Observation;
use waypost_vision::feature_record::FeatureRecord;

use crate::storage::Medium;

/// What an image shows, and how long it took to see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Observed {
    pub(crate) observation: Observation,
    /// Where it shows that; none if only how often is known.
    pub(crate) features: Option<Arc<FeatureRecord>>,
    /// What is kept of it beside its words.
    pub(crate) media: Vec<Medium>,
    pub(crate) extract: Duration,
    pub(crate) quantize: Duration,
}
