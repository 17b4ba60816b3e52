//! Training the words of a vocabulary: k-means for float descriptors, k-majority for binary ones.

mod kmeans;
mod progress;
mod seeding;
mod training_set;
mod tree;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::ops::ControlFlow;

use super::Vocabulary;
use super::error::VocabularyError;
use super::settings::VocabularySettings;
use crate::descriptor::Descriptors;
use crate::quantizer::{Centres, Quantizer};
use progress::Cancelled;
use training_set::TrainingSet;

pub use progress::{TrainingProgress, TrainingStage};

impl Vocabulary {
    /// Up to this many words a trained vocabulary compares a descriptor with every word; above, it
    /// searches a tree. At this size 500 SIFT descriptors take some 6 ms on one core with AVX-512
    /// VNNI, some 30 ms with AVX2.
    pub const EXACT_WORDS_MAX: u32 = 20_000;

    /// Trains k-means (float) or k-majority (binary) words.
    ///
    /// The result depends on the set of descriptors and the settings alone, not on the order of
    /// descriptors or the number of threads. `observer` is called with the progress every second or
    /// so, and stops the training by answering `Break`.
    ///
    /// # Errors
    /// [`VocabularyError`], any but `Descriptors`.
    pub fn train(
        descriptors: &Descriptors,
        settings: &VocabularySettings,
        observer: &mut dyn FnMut(TrainingProgress) -> ControlFlow<()>,
    ) -> Result<Self, VocabularyError> {
        Self::train_with_limit(descriptors, settings, Self::EXACT_WORDS_MAX, observer)
    }

    /// [`Vocabulary::train`] with another limit between exact search and tree.
    pub(super) fn train_with_limit(
        descriptors: &Descriptors,
        settings: &VocabularySettings,
        exact_words_max: u32,
        observer: &mut dyn FnMut(TrainingProgress) -> ControlFlow<()>,
    ) -> Result<Self, VocabularyError> {
        let &VocabularySettings { words, seed, iterations } = settings;
        if !(VocabularySettings::MIN_WORDS..=VocabularySettings::MAX_WORDS).contains(&words) {
            return Err(VocabularyError::Words { words });
        }
        if !(1..=VocabularySettings::MAX_ITERATIONS).contains(&iterations) {
            return Err(VocabularyError::Iterations { iterations });
        }
        let set = TrainingSet::new(descriptors);
        if set.len() < words as usize {
            return Err(VocabularyError::TooFewDescriptors { words, distinct: set.len() });
        }
        let quantizer = if words <= exact_words_max {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let clusters = kmeans::cluster(&set, words as usize, iterations, &mut random, &mut |step| {
                observer(step.progress(iterations))
            });
            clusters.map(|found| Quantizer::Exact(Centres::pack(set.kind, set.width, &found.centres)))
        } else {
            let tree = tree::train(&set, words as usize, iterations, seed, &mut |step| {
                observer(step.progress(iterations))
            });
            tree.map(Quantizer::Tree)
        };
        match quantizer {
            Ok(quantizer) => Ok(Self::new(set.kind, set.width, quantizer)),
            Err(Cancelled) => Err(VocabularyError::Cancelled),
        }
    }
}

#[cfg(test)]
mod tests;
