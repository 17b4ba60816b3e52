//! What a place looks like: how often each word was seen there.

use crate::codec::{DecodeError, Reader, Writer};
use crate::observation::{Observation, WordId};

pub use crate::ids::PlaceId;

/// The appearance of a place L_i: n looks, and for each word the k of them that showed it.
///
/// p(e_q = 1 | L_i) follows from the word, k and n alone. The counts are bounded: at
/// [`Appearance::MAX_LOOKS`] all are halved before the next look, so that the place goes on
/// learning and a (k, n) fits one byte. A word once seen keeps k ≥ 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Appearance {
    looks: u8,
    words: Vec<WordId>,
    hits: Vec<u8>,
}

impl Appearance {
    /// Most looks that are counted; then all counts are halved.
    pub const MAX_LOOKS: u8 = 15;

    /// The appearance after a single look.
    #[must_use]
    pub fn of(observation: &Observation) -> Self {
        let mut appearance = Self::default();
        appearance.observe(observation);
        appearance
    }

    /// From words ascending, each with its k in 1..=`looks`.
    pub(crate) fn from_word_hits(looks: u8, word_hits: impl Iterator<Item = (WordId, u8)>) -> Self {
        let (words, hits) = word_hits.unzip();
        Self { looks, words, hits }
    }

    /// Takes one more look at the place.
    pub fn observe(&mut self, observation: &Observation) {
        if self.looks == Self::MAX_LOOKS {
            self.looks /= 2;
            self.hits.iter_mut().for_each(|k| *k = (*k / 2).max(1));
        }
        self.looks += 1;
        let seen = observation.words();
        let mut words = Vec::with_capacity(self.words.len() + seen.len());
        let mut hits = Vec::with_capacity(words.capacity());
        let mut next = 0;
        for (&word, &k) in self.words.iter().zip(&self.hits) {
            while next < seen.len() && seen[next] < word {
                words.push(seen[next]);
                hits.push(1);
                next += 1;
            }
            let again = seen.get(next) == Some(&word);
            next += usize::from(again);
            words.push(word);
            hits.push(k + u8::from(again));
        }
        words.extend_from_slice(&seen[next..]);
        hits.resize(words.len(), 1);
        (self.words, self.hits) = (words, hits);
    }

    /// n: how often the place was looked at, 0 to [`Appearance::MAX_LOOKS`].
    #[must_use]
    pub fn looks(&self) -> u8 {
        self.looks
    }

    /// The words ever seen here, ascending, each with its k in 1..=n.
    pub fn word_hits(&self) -> impl ExactSizeIterator<Item = (WordId, u8)> + DoubleEndedIterator + '_ {
        self.words.iter().copied().zip(self.hits.iter().copied())
    }

    /// k of a word; 0 if it was never seen here.
    #[must_use]
    pub fn hits(&self, word: WordId) -> u8 {
        self.words.binary_search(&word).map_or(0, |index| self.hits[index])
    }

    /// Appends the byte form: n, number of words, then each word's distance from the one before
    /// and, where it is not 1, its k.
    pub fn encode(&self, writer: &mut Writer) {
        writer.u8(self.looks);
        writer.varint(self.words.len() as u64);
        let mut previous = 0;
        for (word, k) in self.word_hits() {
            writer.varint(u64::from(word.number() - previous) << 1 | u64::from(k > 1));
            if k > 1 {
                writer.u8(k);
            }
            previous = word.number();
        }
    }

    /// Appends a shorter byte form, for many places together: n, number of words, how many words
    /// lie between each and the one before; where n > 1 a bit per word, set if its k is not 1, and
    /// four bits with k for each of those.
    pub fn encode_packed(&self, writer: &mut Writer) {
        writer.u8(self.looks);
        writer.varint(self.words.len() as u64);
        let mut next = 0;
        for &word in &self.words {
            writer.varint(u64::from(word.number() - next));
            next = word.number() + 1;
        }
        if self.looks > 1 {
            for hits in self.hits.chunks(8) {
                writer.u8((0..).zip(hits).fold(0, |bits, (bit, &k)| bits | u8::from(k > 1) << bit));
            }
            let repeated: Vec<u8> = self.hits.iter().copied().filter(|&k| k > 1).collect();
            for pair in repeated.chunks(2) {
                writer.u8(pair[0] | pair.get(1).map_or(0, |k| k << 4));
            }
        }
    }

    /// Reads what [`Appearance::encode_packed`] wrote.
    ///
    /// # Errors
    /// See [`Appearance::decode`].
    pub fn decode_packed(reader: &mut Reader<'_>, vocabulary_len: usize) -> Result<Self, DecodeError> {
        let (looks, len) = decode_counts(reader, vocabulary_len)?;
        let mut words = Vec::with_capacity(len);
        let mut next = 0u64;
        for _ in 0..len {
            let word = next.saturating_add(reader.varint()?);
            if word >= vocabulary_len as u64 {
                return Err(impossible_word(word));
            }
            words.push(WordId::new(word as u32));
            next = word + 1;
        }
        let mut hits = vec![1; len];
        if looks > 1 {
            let bits = reader.raw(len.div_ceil(8))?;
            let is_repeated = |index: &usize| bits[index / 8] >> (index % 8) & 1 == 1;
            let repeated: Vec<usize> = (0..len).filter(is_repeated).collect();
            for pair in repeated.chunks(2) {
                let byte = reader.u8()?;
                for (&index, k) in pair.iter().zip([byte & 15, byte >> 4]) {
                    hits[index] = k;
                }
            }
        }
        match hits.iter().find(|&&k| k == 0 || k > looks) {
            Some(&k) => Err(impossible_hits(k, looks)),
            None => Ok(Self { looks, words, hits }),
        }
    }

    /// Reads what [`Appearance::encode`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut, name a word not below `vocabulary_len` or twice, or
    /// hold counts that no looks give.
    pub fn decode(reader: &mut Reader<'_>, vocabulary_len: usize) -> Result<Self, DecodeError> {
        let (looks, len) = decode_counts(reader, vocabulary_len)?;
        let mut appearance = Self { looks, words: Vec::with_capacity(len), hits: Vec::with_capacity(len) };
        let mut previous = 0u64;
        for index in 0..len {
            let step = reader.varint()?;
            let word = previous.saturating_add(step >> 1);
            if (index > 0 && word == previous) || word >= vocabulary_len as u64 {
                return Err(impossible_word(word));
            }
            let k = if step & 1 == 1 { reader.u8()? } else { 1 };
            if k == 0 || k > looks {
                return Err(impossible_hits(k, looks));
            }
            appearance.words.push(WordId::new(word as u32));
            appearance.hits.push(k);
            previous = word;
        }
        Ok(appearance)
    }
}

/// n and the number of words.
fn decode_counts(reader: &mut Reader<'_>, vocabulary_len: usize) -> Result<(u8, usize), DecodeError> {
    let looks = reader.u8()?;
    if looks > Appearance::MAX_LOOKS {
        return Err(DecodeError::invalid(format_args!("{looks} looks at a place")));
    }
    let len = reader.count(1)?;
    if len > vocabulary_len {
        return Err(DecodeError::invalid(format_args!("{len} words of {vocabulary_len}")));
    }
    Ok((looks, len))
}

fn impossible_word(word: u64) -> DecodeError {
    DecodeError::invalid(format_args!("word {word} of a place"))
}

fn impossible_hits(k: u8, looks: u8) -> DecodeError {
    DecodeError::invalid(format_args!("a word seen in {k} of {looks} looks"))
}

#[cfg(test)]
mod tests;
