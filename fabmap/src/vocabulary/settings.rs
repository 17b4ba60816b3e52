//! How many words a vocabulary is to have, and how they are found.

/// What a vocabulary is trained with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VocabularySettings {
    /// Number of words, 2 to 1,000,000. Up to [`super::Vocabulary::EXACT_WORDS_MAX`] quantization
    /// is exact.
    pub words: u32,
    /// Seed of the random choices; the same descriptors and seed give the same vocabulary.
    pub seed: u64,
    /// Iterations of Lloyd's algorithm at most, 1 to 1,000; it stops when nothing improves.
    pub iterations: u32,
}

impl VocabularySettings {
    /// Fewest words of a vocabulary.
    pub const MIN_WORDS: u32 = 2;
    /// Most words of a vocabulary.
    pub const MAX_WORDS: u32 = 1_000_000;
    /// Most iterations of Lloyd's algorithm.
    pub const MAX_ITERATIONS: u32 = 1_000;
}

impl Default for VocabularySettings {
    fn default() -> Self {
        Self { words: 5_000, seed: 0, iterations: 12 }
    }
}
