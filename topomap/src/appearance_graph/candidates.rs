//! Which images of a map may be similar to a new one, by their words instead of by comparing all.

use std::sync::Arc;

use fabmap::appearance::Appearance;
use fabmap::inverted_index::InvertedIndex;
use fabmap::likelihood::ObservationModel;
use fabmap::observation::Observation;

use super::ImageId;

/// The images of a map as FAB-MAP knows them: each a place of one look.
#[derive(Clone, Debug)]
pub struct CandidateIndex {
    index: InvertedIndex,
}

impl CandidateIndex {
    /// An index without images.
    #[must_use]
    pub fn new(model: Arc<ObservationModel>) -> Self {
        Self { index: InvertedIndex::new(model) }
    }

    /// Adds an image; images are numbered from 0 in order.
    pub fn add(&mut self, observation: &Observation) {
        self.index.add(&Appearance::of(observation));
    }

    /// Number of images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there are no images yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// The `most` images that show the observation with the greatest likelihood, greatest first.
    #[must_use]
    pub fn most_likely(&self, observation: &Observation, most: usize) -> Vec<ImageId> {
        let likelihoods = self.index.log_likelihoods(observation);
        let mut images: Vec<ImageId> = (0..likelihoods.len() as ImageId).collect();
        let order = |a: &ImageId, b: &ImageId| {
            likelihoods[*b as usize].total_cmp(&likelihoods[*a as usize]).then(a.cmp(b))
        };
        if most < images.len() {
            images.select_nth_unstable_by(most, order);
            images.truncate(most);
        }
        images.sort_unstable_by(order);
        images
    }
}
