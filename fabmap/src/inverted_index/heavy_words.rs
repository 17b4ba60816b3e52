//! Words that many of a block's places show, as one bit a place.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "code compiled for AVX-512 is called after asking the processor for it")
)]

use super::posting::BLOCK_PLACES;
use super::weights::{FixedPoint, QueryWeights};
use crate::observation::WordId;

/// The places of a block that were looked at once and showed a word.
pub(super) type PlaceBits = [u64; BLOCK_PLACES / 64];

/// A word with at least so many places takes no more memory as bits than as postings, and less
/// time: eight places are added at once, whether they have the word or not.
pub(super) const FEWEST_PLACES: usize = BLOCK_PLACES / 8;

/// Heavy words of a block, ascending.
#[derive(Clone, Debug, Default)]
pub(super) struct HeavyWords {
    words: Vec<WordId>,
    places: Vec<PlaceBits>,
}

impl HeavyWords {
    /// Adds the last of all words.
    pub(super) fn push(&mut self, word: WordId, places: PlaceBits) {
        self.words.push(word);
        self.places.push(places);
    }

    /// All heavy words with their places, ascending.
    pub(super) fn iter(&self) -> impl Iterator<Item = (WordId, &PlaceBits)> {
        self.words.iter().copied().zip(&self.places)
    }

    /// The places with a word; `None` if it is not a heavy one.
    pub(super) fn places_with(&self, word: WordId) -> Option<&PlaceBits> {
        self.words.binary_search(&word).ok().map(|index| &self.places[index])
    }

    /// Forgets that `place` has `word`; false if it did not know.
    pub(super) fn remove(&mut self, word: WordId, place: usize) -> bool {
        let Ok(index) = self.words.binary_search(&word) else { return false };
        let bits = &mut self.places[index][place / 64];
        let before = std::mem::replace(bits, *bits & !(1 << (place % 64)));
        before != *bits
    }

    /// Number of postings.
    pub(super) fn postings(&self) -> usize {
        self.places.iter().flatten().map(|bits| bits.count_ones() as usize).sum()
    }

    pub(super) fn shrink_to_fit(&mut self) {
        self.words.shrink_to_fit();
        self.places.shrink_to_fit();
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.words.capacity() * size_of::<WordId>() + self.places.capacity() * size_of::<PlaceBits>()
    }

    /// Adds the weights of a query's heavy words to the sums of the places that have them.
    pub(super) fn add(&self, query: &QueryWeights, sums: &mut [FixedPoint; BLOCK_PLACES]) {
        let weight = |(word, places)| Some((query.of_one_look(word)?, places));
        let mut weighted = self.words.iter().copied().zip(&self.places).filter_map(weight);
        // So many at once that what is read of them stays in the first-level cache beside the sums.
        let mut some: [(FixedPoint, &PlaceBits); 64] = [(0, &[0; BLOCK_PLACES / 64]); 64];
        loop {
            let mut count = 0;
            for (slot, weighted) in some.iter_mut().zip(weighted.by_ref()) {
                *slot = weighted;
                count += 1;
            }
            if count == 0 {
                return;
            }
            add_weights(&some[..count], sums);
        }
    }
}

/// The places of bits, ascending.
pub(super) fn set_places(bits: &PlaceBits) -> impl Iterator<Item = usize> + '_ {
    (0..).step_by(64).zip(bits).flat_map(|(first, &bits)| {
        let mut rest = bits;
        std::iter::from_fn(move || {
            let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
            rest &= rest - 1;
            Some(first + bit)
        })
    })
}

fn add_weights(weighted: &[(FixedPoint, &PlaceBits)], sums: &mut [FixedPoint; BLOCK_PLACES]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx512f") {
        // SAFETY: the processor has just said that it has these instructions.
        return unsafe { kernel::add_weights(weighted, sums) };
    }
    add_weights_plainly(weighted, sums);
}

fn add_weights_plainly(weighted: &[(FixedPoint, &PlaceBits)], sums: &mut [FixedPoint; BLOCK_PLACES]) {
    for &(weight, places) in weighted {
        set_places(places).for_each(|place| sums[place % BLOCK_PLACES] += weight);
    }
}

#[cfg(target_arch = "x86_64")]
mod kernel {
    use super::{BLOCK_PLACES, FixedPoint, PlaceBits};
    use std::arch::x86_64::{
        __m512i, _mm512_loadu_epi64, _mm512_mask_add_epi64, _mm512_set1_epi64, _mm512_storeu_epi64,
    };

    /// 64 places in eight registers, to which every word is added before the next 64.
    #[target_feature(enable = "avx512f")]
    pub(super) fn add_weights(weighted: &[(FixedPoint, &PlaceBits)], sums: &mut [FixedPoint; BLOCK_PLACES]) {
        let (chunks, _) = sums.as_chunks_mut::<64>();
        for (chunk, sums) in chunks.iter_mut().enumerate() {
            let (eights, _) = sums.as_chunks_mut::<8>();
            let mut registers: [__m512i; 8] = std::array::from_fn(|eight| {
                // SAFETY: eight sums are read.
                unsafe { _mm512_loadu_epi64(eights[eight].as_ptr()) }
            });
            for &(weight, places) in weighted {
                let weight = _mm512_set1_epi64(weight);
                let bits = places[chunk].to_le_bytes();
                for (sums, bits) in registers.iter_mut().zip(bits) {
                    *sums = _mm512_mask_add_epi64(*sums, bits, *sums, weight);
                }
            }
            for (eight, register) in eights.iter_mut().zip(registers) {
                // SAFETY: eight sums are written.
                unsafe { _mm512_storeu_epi64(eight.as_mut_ptr(), register) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn eight_at_once_are_one_by_one(
            bits in proptest::collection::vec((any::<i32>(), any::<u64>()), 0..100), start in any::<i32>(),
        ) {
            let places: Vec<(FixedPoint, PlaceBits)> = bits
                .iter()
                .map(|&(weight, bits)| {
                    (FixedPoint::from(weight), std::array::from_fn(|index| bits.rotate_left(index as u32)))
                })
                .collect();
            let weighted: Vec<(FixedPoint, &PlaceBits)> = places.iter().map(|(weight, bits)| (*weight, bits)).collect();
            let mut sums = [FixedPoint::from(start); BLOCK_PLACES];
            let mut plain = sums;
            add_weights(&weighted, &mut sums);
            add_weights_plainly(&weighted, &mut plain);
            prop_assert_eq!(sums, plain);
            for place in [0, 63, 64, 4095] {
                let with = |(_, bits): &&(FixedPoint, PlaceBits)| bits[place / 64] >> (place % 64) & 1 == 1;
                let sum: FixedPoint = places.iter().filter(with).map(|(weight, _)| weight).sum();
                prop_assert_eq!(sums[place], FixedPoint::from(start) + sum);
            }
        }
    }
}
