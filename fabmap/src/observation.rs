//! An observation Z: which words of the vocabulary an image shows, and how often.

use crate::codec::{DecodeError, Reader, Writer};

pub use crate::ids::WordId;

/// An observation Z: the words seen in one image, ascending, each with how often it was seen.
///
/// FAB-MAP's z_q is 1 for the words listed and 0 for all others; the counts serve the tf-idf
/// baseline alone.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Observation {
    words: Vec<WordId>,
    counts: Vec<u32>,
}

/// Why words are not an observation.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ObservationError {
    /// A word that the vocabulary does not have.
    #[error(
        "word {word} is not in a vocabulary of {vocabulary_len} words; quantize with the map's own model"
    )]
    UnknownWord {
        /// The word.
        word: WordId,
        /// Words in the vocabulary.
        vocabulary_len: usize,
    },
    /// A word that is listed twice.
    #[error("word {word} is listed twice; list each word once, with how often it was seen")]
    RepeatedWord {
        /// The word.
        word: WordId,
    },
    /// A word that was seen no times.
    #[error("word {word} is listed with a count of 0; leave out words that were not seen")]
    UnseenWord {
        /// The word.
        word: WordId,
    },
}

impl Observation {
    /// Collects words in any order, repeated as often as they were seen.
    ///
    /// # Errors
    /// [`ObservationError::UnknownWord`] if a word is not below `vocabulary_len`.
    pub fn from_words(
        words: impl IntoIterator<Item: Into<WordId>>,
        vocabulary_len: usize,
    ) -> Result<Self, ObservationError> {
        let mut sorted: Vec<WordId> = words.into_iter().map(Into::into).collect();
        sorted.sort_unstable();
        if let Some(&word) = sorted.last().filter(|&&last| last.index() >= vocabulary_len) {
            return Err(ObservationError::UnknownWord { word, vocabulary_len });
        }
        let mut observation = Self::default();
        for run in sorted.chunk_by(|a, b| a == b) {
            observation.words.push(run[0]);
            observation.counts.push(u32::try_from(run.len()).unwrap_or(u32::MAX));
        }
        Ok(observation)
    }

    /// Collects words with how often each was seen, in any order.
    ///
    /// # Errors
    /// [`ObservationError`] if a word is not below `vocabulary_len`, is there twice, or was seen no
    /// times.
    pub fn from_word_counts(
        word_counts: impl IntoIterator<Item = (impl Into<WordId>, u32)>,
        vocabulary_len: usize,
    ) -> Result<Self, ObservationError> {
        let mut sorted: Vec<(WordId, u32)> =
            word_counts.into_iter().map(|(word, count)| (word.into(), count)).collect();
        sorted.sort_unstable();
        if let Some(&(word, _)) = sorted.last().filter(|(last, _)| last.index() >= vocabulary_len) {
            return Err(ObservationError::UnknownWord { word, vocabulary_len });
        }
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(ObservationError::RepeatedWord { word: pair[0].0 });
        }
        if let Some(&(word, _)) = sorted.iter().find(|(_, count)| *count == 0) {
            return Err(ObservationError::UnseenWord { word });
        }
        let (words, counts) = sorted.into_iter().unzip();
        Ok(Self { words, counts })
    }

    /// From words ascending, each seen once.
    pub(crate) fn of_ascending(words: Vec<WordId>) -> Self {
        let counts = vec![1; words.len()];
        Self { words, counts }
    }

    /// The words seen, ascending, each once.
    #[must_use]
    pub fn words(&self) -> &[WordId] {
        &self.words
    }

    /// Words with how often each was seen (at least once), ascending by word.
    pub fn word_counts(&self) -> impl Iterator<Item = (WordId, u32)> + '_ {
        self.words.iter().copied().zip(self.counts.iter().copied())
    }

    /// The numbers of the words seen, ascending, and beside them how often each was seen.
    #[must_use]
    pub fn histogram(&self) -> (Vec<u32>, Vec<u32>) {
        (self.words.iter().copied().map(u32::from).collect(), self.counts.clone())
    }

    /// Number of different words seen.
    #[must_use]
    pub fn len(&self) -> usize {
        self.words.len()
    }

    /// True if no word was seen.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// z_q: whether `word` was seen.
    #[must_use]
    pub fn contains(&self, word: WordId) -> bool {
        self.words.binary_search(&word).is_ok()
    }

    /// Appends the byte form: number of words, then for each the distance from the word before
    /// and, where it is not 1, its count. About 1.5 bytes a word at 10,000 words.
    pub fn encode(&self, writer: &mut Writer) {
        writer.varint(self.words.len() as u64);
        let mut previous = 0;
        for (word, count) in self.word_counts() {
            let repeated = u64::from(count > 1);
            writer.varint(u64::from(word.number() - previous) << 1 | repeated);
            if count > 1 {
                writer.varint(u64::from(count));
            }
            previous = word.number();
        }
    }

    /// Reads what [`Observation::encode`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut or hold a word not below `vocabulary_len`, a word
    /// twice, or a count of 0.
    pub fn decode(reader: &mut Reader<'_>, vocabulary_len: usize) -> Result<Self, DecodeError> {
        let len = reader.count(1)?;
        if len > vocabulary_len {
            return Err(DecodeError::invalid(format_args!("{len} words of {vocabulary_len}")));
        }
        let mut observation = Self { words: Vec::with_capacity(len), counts: Vec::with_capacity(len) };
        let mut previous = 0u64;
        for index in 0..len {
            let step = reader.varint()?;
            let word = previous.saturating_add(step >> 1);
            if (index > 0 && word == previous) || word >= vocabulary_len as u64 {
                return Err(DecodeError::invalid(format_args!("word {word} of an observation")));
            }
            let count = if step & 1 == 1 { reader.varint_u32()? } else { 1 };
            if count == 0 {
                return Err(DecodeError::invalid("a word counted 0 times"));
            }
            observation.words.push(WordId::new(word as u32));
            observation.counts.push(count);
            previous = word;
        }
        Ok(observation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn words_and_counts_say_the_same(words in proptest::collection::vec(0..5000u32, 0..400)) {
            let observation = Observation::from_words(words, 5000).unwrap();
            let mut counts: Vec<_> = observation.word_counts().collect();
            counts.reverse();
            prop_assert_eq!(Observation::from_word_counts(counts.clone(), 5000), Ok(observation));
            if let Some(&(word, count)) = counts.first() {
                let repeated = counts.iter().copied().chain([(word, count)]);
                prop_assert_eq!(Observation::from_word_counts(repeated, 5000), Err(ObservationError::RepeatedWord { word }));
                let unknown = Observation::from_word_counts(counts.iter().copied(), word.index());
                prop_assert_eq!(unknown, Err(ObservationError::UnknownWord { word, vocabulary_len: word.index() }));
                let unseen = Observation::from_word_counts([(word, 0)], 5000);
                prop_assert_eq!(unseen, Err(ObservationError::UnseenWord { word }));
            }
        }

        #[test]
        fn bytes_give_the_observation_back(words in proptest::collection::vec(0..5000u32, 0..400)) {
            let observation = Observation::from_words(words, 5000).unwrap();
            let mut writer = Writer::default();
            observation.encode(&mut writer);
            let bytes = writer.into_bytes();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Observation::decode(&mut reader, 5000), Ok(observation));
            prop_assert_eq!(reader.end(), Ok(()));
        }

        #[test]
        fn foreign_bytes_never_make_an_unsorted_observation(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            if let Ok(observation) = Observation::decode(&mut Reader::new(&bytes), 300) {
                prop_assert!(observation.words().is_sorted_by(|a, b| a < b));
                prop_assert!(observation.words().iter().all(|&word| word.index() < 300));
            }
        }
    }

    #[test]
    fn words_are_counted_and_sorted() {
        let observation = Observation::from_words([7, 2, 7, 0], 8).unwrap();
        assert_eq!(
            observation.word_counts().collect::<Vec<_>>(),
            [(0, 1), (2, 1), (7, 2)].map(|(word, count)| (WordId::new(word), count))
        );
        assert!(observation.contains(WordId::new(2)) && !observation.contains(WordId::new(3)));
    }

    #[test]
    fn a_word_beyond_the_vocabulary_is_refused() {
        let refused = Observation::from_words([1, 8], 8);
        assert_eq!(refused, Err(ObservationError::UnknownWord { word: WordId::new(8), vocabulary_len: 8 }));
    }
}
