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

#[cfg(test)]
mod tests {
    use fabmap::chow_liu::{ChowLiuTree, WordDependence};
    use fabmap::detector::DetectorModel;
    use fabmap::likelihood::Dependence;
    use fabmap::observation::WordId;
    use proptest::prelude::*;

    use super::*;

    const WORDS: usize = 20;

    fn model() -> Arc<ObservationModel> {
        let rows = (0..WORDS as WordId).map(|word| WordDependence {
            parent: word.saturating_sub(1),
            marginal: 0.2,
            given_parent_seen: 0.4,
            given_parent_unseen: 0.15,
        });
        let tree = ChowLiuTree::from_rows(rows).unwrap();
        Arc::new(ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu))
    }

    fn look() -> impl Strategy<Value = Observation> {
        prop::collection::vec(0..WORDS as WordId, 1..8)
            .prop_map(|words| Observation::from_words(words, WORDS).unwrap())
    }

    proptest! {
        /// Few of many are the first of all.
        #[test]
        fn the_most_likely_come_first(looks in prop::collection::vec(look(), 1..30), now in look(), most in 0..35usize) {
            let mut index = CandidateIndex::new(model());
            looks.iter().for_each(|look| index.add(look));
            let all = index.most_likely(&now, looks.len());
            let mut numbers = all.clone();
            numbers.sort_unstable();
            prop_assert_eq!(numbers, (0..looks.len() as ImageId).collect::<Vec<_>>());
            prop_assert_eq!(&index.most_likely(&now, most)[..], &all[..most.min(all.len())]);
            let likelihood = |image: ImageId| model().dense_log_likelihood(&now, &Appearance::of(&looks[image as usize]));
            prop_assert!(all.windows(2).all(|pair| likelihood(pair[0]) >= likelihood(pair[1]) - 1e-6));
        }
    }
}
