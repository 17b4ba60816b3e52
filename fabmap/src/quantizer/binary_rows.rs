//! Binary centres as 64-bit limbs.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "code compiled for AVX2 is called after asking the processor for it")
)]

use super::nearest::Nearest;

/// Binary centres for the search of the nearest by Hamming distance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct BinaryRows {
    width: usize,
    limbs: Vec<u64>,
}

impl BinaryRows {
    /// Packs consecutive rows of `width` bytes.
    pub(super) fn pack(width: usize, rows: &[u8]) -> Self {
        Self { width, limbs: to_limbs(width, rows) }
    }

    pub(super) fn len(&self) -> usize {
        self.limbs.len() / self.limbs_per_row()
    }

    /// Appends centre `index` as it was packed.
    pub(super) fn unpack(&self, index: usize, row: &mut Vec<u8>) {
        let end = row.len() + self.width;
        let count = self.limbs_per_row();
        row.extend(self.limbs[index * count..(index + 1) * count].iter().flat_map(|limb| limb.to_le_bytes()));
        row.truncate(end);
    }

    /// The nearest centre of each row, the lowest number among equals.
    pub(super) fn nearest(&self, rows: &[u8], nearest: &mut [Nearest]) {
        let queries = to_limbs(self.width, rows);
        nearest.fill(Nearest { id: 0, distance: u32::MAX });
        self.search_fast(&queries, nearest);
    }

    /// Distances of each row from all centres, row by row.
    pub(super) fn distances(&self, rows: &[u8]) -> Vec<u32> {
        let queries = to_limbs(self.width, rows);
        let centres = || self.limbs.chunks_exact(self.limbs_per_row());
        let queries = queries.chunks_exact(self.limbs_per_row());
        queries.flat_map(|query| centres().map(|centre| hamming(centre, query))).collect()
    }

    /// [`BinaryRows::search`], compiled for this processor.
    fn search_fast(&self, queries: &[u64], nearest: &mut [Nearest]) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2,popcnt")]
            fn avx2(centres: &BinaryRows, queries: &[u64], nearest: &mut [Nearest]) {
                centres.search(queries, nearest);
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
                // SAFETY: the processor has just said that it has these instructions.
                return unsafe { avx2(self, queries, nearest) };
            }
        }
        self.search(queries, nearest);
    }

    /// The search itself, with the loop unrolled for the widths of ORB (32 bytes) and AKAZE (61).
    #[inline(always)]
    fn search(&self, queries: &[u64], nearest: &mut [Nearest]) {
        match self.limbs_per_row() {
            4 => self.search_unrolled::<4>(queries, nearest),
            8 => self.search_unrolled::<8>(queries, nearest),
            count => {
                for (id, centre) in self.limbs.chunks_exact(count).enumerate() {
                    for (query, nearest) in queries.chunks_exact(count).zip(nearest.iter_mut()) {
                        nearest.improve(id as u32, hamming(centre, query));
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn search_unrolled<const LIMBS: usize>(&self, queries: &[u64], nearest: &mut [Nearest]) {
        let (centres, _) = self.limbs.as_chunks::<LIMBS>();
        let (queries, _) = queries.as_chunks::<LIMBS>();
        for (id, centre) in centres.iter().enumerate() {
            for (query, nearest) in queries.iter().zip(nearest.iter_mut()) {
                nearest.improve(id as u32, hamming(centre, query));
            }
        }
    }

    fn limbs_per_row(&self) -> usize {
        self.width.div_ceil(8)
    }
}

fn to_limbs(width: usize, rows: &[u8]) -> Vec<u64> {
    let limb = |bytes: &[u8]| {
        let mut padded = [0; 8];
        padded[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(padded)
    };
    rows.chunks_exact(width).flat_map(|row| row.chunks(8).map(limb)).collect()
}

#[inline(always)]
fn hamming(a: &[u64], b: &[u64]) -> u32 {
    a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn vector_instructions_and_plain_loops_agree(
            width in prop_oneof![Just(32usize), Just(61), 1..70usize],
            centres in proptest::collection::vec(any::<u8>(), 70..2000),
            rows in proptest::collection::vec(any::<u8>(), 70..800),
        ) {
            let binary = BinaryRows::pack(width, &centres);
            let queries = to_limbs(width, &rows);
            let mut plain = vec![Nearest { id: 0, distance: u32::MAX }; rows.len() / width];
            let mut vector = plain.clone();
            binary.search(&queries, &mut plain);
            binary.search_fast(&queries, &mut vector);
            prop_assert_eq!(vector, plain);
        }
    }
}
