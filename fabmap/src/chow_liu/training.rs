//! Learning the tree from training observations (Chow & Liu 1968).
//!
//! Of all trees, p(Z) = Π p(z_q | z_pq) is nearest to the distribution of the observations, by
//! Kullback-Leibler divergence, for the one whose edges have the greatest sum of mutual
//! information.

mod spanning_forest;
mod word_statistics;

use std::ops::ControlFlow;

use super::{ChowLiuError, ChowLiuTree};
use crate::observation::{Observation, WordId};
use spanning_forest::maximum_spanning_forest;
use word_statistics::WordStatistics;

/// Settings of [`ChowLiuTree::train`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeTrainingSettings {
    /// Strength of the prior on every probability, in images: a marginal is drawn to the mean rate
    /// of all words, a conditional to its word's marginal, as if so many images had shown it.
    /// Above 0.
    pub prior_images: f64,
}

impl Default for TreeTrainingSettings {
    fn default() -> Self {
        Self { prior_images: 1.0 }
    }
}

/// Why no tree could be learnt.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TreeTrainingError {
    /// No observation to learn from.
    #[error("a Chow-Liu tree is learnt from observations, and there are none; give at least one image")]
    NoObservations,
    /// An observation has a word that the vocabulary does not.
    #[error(
        "observation {observation} has word {word}, the vocabulary ends at {words} words; quantize again"
    )]
    UnknownWord {
        /// Number of the observation, from 0.
        observation: usize,
        /// The word.
        word: WordId,
        /// Words in the vocabulary.
        words: usize,
    },
    /// The prior is not a positive number.
    #[error("the prior must be a positive number of images, not {prior_images}; 1 is a good start")]
    Prior {
        /// The prior given.
        prior_images: f64,
    },
    /// The observer asked to stop.
    #[error("training was cancelled")]
    Cancelled,
    /// The vocabulary cannot carry a tree.
    #[error(transparent)]
    Tree(#[from] ChowLiuError),
}

impl ChowLiuTree {
    /// Learns the maximum spanning forest over the mutual information of `words` words.
    ///
    /// An edge joins two words only if some image shows both: a pair that never met has nothing to
    /// say about p(z_q = 1 | z_pq = 1), so words that meet no other stay roots. Mutual information
    /// is that of the plain counts; probabilities are then smoothed by `settings.prior_images`.
    ///
    /// Prim's algorithm: when a word joins the forest its co-occurrences are counted from the
    /// images that show it, so memory is linear in words and observations and time is Σ|Z|² (words
    /// are sparse; compare Meilă's accelerated Chow-Liu, 1999). Ties go to the lower word id.
    /// `observer` is called with the fraction done, in [0, 1], and may cancel.
    ///
    /// # Errors
    /// [`TreeTrainingError`].
    pub fn train(
        observations: &[Observation],
        words: usize,
        settings: TreeTrainingSettings,
        observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Self, TreeTrainingError> {
        let statistics = WordStatistics::count(observations, words, settings.prior_images)?;
        let edges = maximum_spanning_forest(observations, &statistics, observer)?;
        Ok(Self::from_rows(WordId::all().zip(edges).map(|(word, edge)| statistics.dependence(word, edge)))?)
    }
}

#[cfg(test)]
mod tests;
