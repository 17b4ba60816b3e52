//! Where within its word a descriptor lies, in 128 bits: Hamming embedding (Jégou, Douze & Schmid,
//! ECCV 2008).
//!
//! Two features of one word are mostly two different things. Their signatures tell without a look
//! at the descriptors: those of one thing differ in few bits, those of two in about half.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use fabmap::descriptor::{DescriptorError, DescriptorKind, Descriptors};
use fabmap::observation::WordId;
use fabmap::vocabulary::Vocabulary;

/// On which side of its word's centre a descriptor lies, in 128 directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Signature([u64; 2]);

/// A feature as a word, and where within the word.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct SignedWord {
    /// Its word.
    pub word: WordId,
    /// Where within.
    pub signature: Signature,
}

/// Makes the signatures of a vocabulary's words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signatures {
    centres: Descriptors,
    /// By dimension, and beyond up to a power of two.
    is_flipped: Vec<bool>,
}

/// Why features have no signatures.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SignatureError {
    /// Not one word for each descriptor.
    #[error("{words} words of {descriptors} descriptors; give one word for each descriptor")]
    Uneven {
        /// Words given.
        words: usize,
        /// Descriptors given.
        descriptors: usize,
    },
    /// A word that the vocabulary does not have.
    #[error("there is no word {word} in a vocabulary of {words}; take the words from the same vocabulary")]
    UnknownWord {
        /// The word.
        word: WordId,
        /// Words that there are.
        words: usize,
    },
    /// The descriptors are not of this vocabulary's feature.
    #[error(transparent)]
    Descriptors(#[from] DescriptorError),
}

impl Signature {
    /// Bits of a signature.
    pub const BITS: u32 = 128;

    /// In how many bits two differ, up to [`Signature::BITS`].
    #[must_use]
    #[inline]
    pub fn differing_bits(self, other: Self) -> u32 {
        let ([a, b], [c, d]) = (self.0, other.0);
        (a ^ c).count_ones() + (b ^ d).count_ones()
    }

    fn from_bits(bits: impl Iterator<Item = bool>) -> Self {
        let mut signature = [0; 2];
        for (number, is_set) in bits.take(Self::BITS as usize).enumerate() {
            signature[number / 64] |= u64::from(is_set) << (number % 64);
        }
        Self(signature)
    }
}

impl Signatures {
    /// Signatures of features whose words are those of `vocabulary`.
    #[must_use]
    pub fn new(vocabulary: &Vocabulary) -> Self {
        let directions = vocabulary.width().max(Signature::BITS as usize).next_power_of_two();
        // Any flips will do, if they are always the same.
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let is_flipped = (0..directions).map(|_| random.random()).collect();
        Self { centres: vocabulary.centres(), is_flipped }
    }

    /// Each feature's word, by [`Vocabulary::words`], with its signature.
    ///
    /// # Errors
    /// [`SignatureError`] if words and descriptors are not of one image, or not of this vocabulary.
    pub fn sign(
        &self,
        words: &[WordId],
        descriptors: &Descriptors,
    ) -> Result<Vec<SignedWord>, SignatureError> {
        if words.len() != descriptors.len() {
            return Err(SignatureError::Uneven { words: words.len(), descriptors: descriptors.len() });
        }
        let expected = self.centres.kind();
        let expected_width = self.centres.width();
        let found = descriptors.kind();
        let found_width = descriptors.width();
        if (expected, expected_width) != (found, found_width) {
            let mismatch = DescriptorError::Mismatch { expected, expected_width, found, found_width };
            return Err(SignatureError::Descriptors(mismatch));
        }
        let known = self.centres.len();
        if let Some(&word) = words.iter().find(|&&word| word.index() >= known) {
            return Err(SignatureError::UnknownWord { word, words: known });
        }
        let signed = |(&word, row): (&WordId, &[u8])| SignedWord { word, signature: self.of(word, row) };
        Ok(words.iter().zip(descriptors.rows()).map(signed).collect())
    }

    fn of(&self, word: WordId, descriptor: &[u8]) -> Signature {
        match self.centres.kind() {
            DescriptorKind::Float => self.sides(self.centres.row(word.index()), descriptor),
            // A bit of the descriptor is a side by itself, and the centre's bits would only turn
            // both over.
            DescriptorKind::Binary => Signature::from_bits(
                spread(descriptor.len() * 8).map(|bit| descriptor[bit / 8] >> (bit % 8) & 1 == 1),
            ),
        }
    }

    /// Signs of the randomised Hadamard transform of what parts a descriptor from its word's
    /// centre.
    fn sides(&self, centre: &[u8], descriptor: &[u8]) -> Signature {
        let mut apart = vec![0_i32; self.is_flipped.len()];
        for (((apart, is_flipped), &at), &from) in
            apart.iter_mut().zip(&self.is_flipped).zip(descriptor).zip(centre)
        {
            let difference = i32::from(at) - i32::from(from);
            *apart = if *is_flipped { -difference } else { difference };
        }
        hadamard(&mut apart);
        Signature::from_bits(spread(apart.len()).map(|direction| apart[direction] > 0))
    }
}

/// As many numbers below `count` as a signature has bits, evenly spread.
fn spread(count: usize) -> impl Iterator<Item = usize> {
    let bits = Signature::BITS as usize;
    (0..bits).map(move |bit| bit * count / bits)
}

/// Row r of the result is the sum of all values, value c with the sign (-1) to the number of ones
/// in r & c.
fn hadamard(values: &mut [i32]) {
    let mut half = 1;
    while half < values.len() {
        for pair in values.chunks_exact_mut(2 * half) {
            let (left, right) = pair.split_at_mut(half);
            for (left, right) in left.iter_mut().zip(right) {
                (*left, *right) = (*left + *right, *left - *right);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use proptest::prelude::*;

    use super::*;
    use fabmap::vocabulary::VocabularySettings;

    fn rows(width: usize, count: usize, seed: u64) -> Vec<u8> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..width * count).map(|_| random.random()).collect()
    }

    fn signatures(kind: DescriptorKind, width: usize) -> (Vocabulary, Signatures) {
        let training = Descriptors::new(kind, width, rows(width, 60, 1)).unwrap();
        let settings = VocabularySettings { words: 4, ..VocabularySettings::default() };
        let vocabulary = Vocabulary::train(&training, &settings, &mut |_| ControlFlow::Continue(())).unwrap();
        let signatures = Signatures::new(&vocabulary);
        (vocabulary, signatures)
    }

    proptest! {
        /// Each bit by the sum that defines it.
        #[test]
        fn bits_are_the_signs_of_plain_sums(width in 1..300usize, seed in any::<u64>(), word in (0..4u32).prop_map(WordId::new)) {
            let (vocabulary, signatures) = signatures(DescriptorKind::Float, width);
            let descriptor = Descriptors::new(DescriptorKind::Float, width, rows(width, 1, seed)).unwrap();
            let signed = signatures.sign(&[word], &descriptor).unwrap()[0];
            let centres = vocabulary.centres();
            let directions = signatures.is_flipped.len();
            let sum = |direction: usize| (0..width).map(|dimension| {
                let apart = f64::from(descriptor.row(0)[dimension]) - f64::from(centres.row(word.index())[dimension]);
                let ones = (direction & dimension).count_ones() + u32::from(signatures.is_flipped[dimension]);
                if ones.is_multiple_of(2) { apart } else { -apart }
            }).sum::<f64>();
            let plain = (0..128).map(|bit| sum(bit * directions / 128) > 0.0);
            prop_assert_eq!(signed, SignedWord { word, signature: Signature::from_bits(plain) });
        }

        #[test]
        fn bits_of_binary_descriptors_are_their_own(seed in any::<u64>(), word in (0..4u32).prop_map(WordId::new)) {
            let (_, signatures) = signatures(DescriptorKind::Binary, 16);
            let pair = Descriptors::new(DescriptorKind::Binary, 16, rows(16, 2, seed)).unwrap();
            let signed = signatures.sign(&[word, word], &pair).unwrap();
            let apart = DescriptorKind::Binary.distance(pair.row(0), pair.row(1));
            prop_assert_eq!(signed[0].signature.differing_bits(signed[1].signature), apart);
        }
    }

    #[test]
    fn what_is_near_differs_in_few_bits() {
        let (_, signatures) = signatures(DescriptorKind::Float, 128);
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let one = rows(128, 1, 2);
        let near: Vec<u8> = one.iter().map(|&at| at.saturating_add(random.random_range(0..20))).collect();
        let all = [one, near, rows(128, 1, 3)].concat();
        let descriptors = Descriptors::new(DescriptorKind::Float, 128, all).unwrap();
        let signed = signatures.sign(&[WordId::new(1); 3], &descriptors).unwrap();
        let apart = |other: usize| signed[0].signature.differing_bits(signed[other].signature);
        assert!(apart(1) < 20 && (40..88).contains(&apart(2)), "{} {}", apart(1), apart(2));
    }

    #[test]
    fn what_is_not_of_the_vocabulary_has_no_signature() {
        let (_, signatures) = signatures(DescriptorKind::Float, 8);
        let two = Descriptors::new(DescriptorKind::Float, 8, rows(8, 2, 1)).unwrap();
        let uneven = SignatureError::Uneven { words: 1, descriptors: 2 };
        assert_eq!(signatures.sign(&[WordId::new(0)], &two), Err(uneven));
        let unknown = SignatureError::UnknownWord { word: WordId::new(4), words: 4 };
        assert_eq!(signatures.sign(&[0, 4].map(WordId::new), &two), Err(unknown));
        let other = Descriptors::new(DescriptorKind::Binary, 8, rows(8, 2, 1)).unwrap();
        assert!(matches!(
            signatures.sign(&[0, 0].map(WordId::new), &other),
            Err(SignatureError::Descriptors(_))
        ));
    }
}
