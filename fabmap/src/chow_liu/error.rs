//! Why rows are not a tree.

use crate::observation::WordId;

/// Why rows are not a tree.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ChowLiuError {
    /// No word at all, or more than 32 bits can number.
    #[error("a Chow-Liu tree needs 1 to {max} words, not {words}", max = u32::MAX)]
    Size {
        /// Words given.
        words: usize,
    },
    /// A parent that does not exist.
    #[error("word {word} names parent {parent}, which does not exist; use a word of the same tree")]
    Parent {
        /// The word.
        word: WordId,
        /// Its parent.
        parent: WordId,
    },
    /// A probability that would make a word certain.
    #[error("word {word} has probability {probability}; every probability must lie strictly between 0 and 1")]
    Probability {
        /// The word.
        word: WordId,
        /// The probability out of range.
        probability: f64,
    },
    /// A word that is its own ancestor.
    #[error("word {word} is its own ancestor; a tree has no cycles")]
    Cycle {
        /// A word on the cycle.
        word: WordId,
    },
}
