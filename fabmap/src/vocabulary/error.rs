//! Why there is no vocabulary, or no words.

use super::settings::VocabularySettings;
use crate::descriptor::DescriptorError;

/// Why there is no vocabulary, or no words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VocabularyError {
    /// The number of words is out of range.
    #[error("a vocabulary of {words} words is not supported; ask for {lowest} to {highest}",
        lowest = VocabularySettings::MIN_WORDS, highest = VocabularySettings::MAX_WORDS)]
    Words {
        /// Words asked for.
        words: u32,
    },
    /// The number of iterations is out of range.
    #[error("{iterations} iterations are not supported; ask for {lowest} to {highest}",
        lowest = 1, highest = VocabularySettings::MAX_ITERATIONS)]
    Iterations {
        /// Iterations asked for.
        iterations: u32,
    },
    /// There are fewer different descriptors than words.
    #[error(
        "{words} words cannot be trained from {distinct} different descriptors; \
         give more images or ask for at most {distinct} words"
    )]
    TooFewDescriptors {
        /// Words asked for.
        words: u32,
        /// Different descriptors given.
        distinct: usize,
    },
    /// The observer asked to stop.
    #[error("training was cancelled; nothing was kept, so start it again")]
    Cancelled,
    /// The descriptors are not of this vocabulary's feature.
    #[error(transparent)]
    Descriptors(#[from] DescriptorError),
}
