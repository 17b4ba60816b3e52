//! Distances between rows of bytes, many at a time.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "code compiled for AVX2 is called after asking the processor for it")
)]

use super::DescriptorKind;

/// Lowers each row's distance to that from `seed` where that is nearer.
pub(crate) fn lower_distances(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32]) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,popcnt")]
        fn avx2(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32]) {
            lower_plainly(kind, seed, rows, distances);
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
            // SAFETY: the processor has just said that it has these instructions.
            return unsafe { avx2(kind, seed, rows, distances) };
        }
    }
    lower_plainly(kind, seed, rows, distances);
}

#[inline(always)]
fn lower_plainly(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32]) {
    for (row, distance) in rows.chunks_exact(seed.len()).zip(distances) {
        *distance = kind.distance(seed, row).min(*distance);
    }
}

/// Differences fit 16 bits and are squared from there: compilers make that one vector instruction.
#[inline(always)]
pub(super) fn squared_euclidean(a: &[u8], b: &[u8]) -> u32 {
    let squares = a.iter().zip(b).map(|(&x, &y)| {
        let difference = i16::from(x) - i16::from(y);
        i32::from(difference) * i32::from(difference)
    });
    squares.sum::<i32>().unsigned_abs()
}

#[inline(always)]
pub(super) fn hamming(a: &[u8], b: &[u8]) -> u32 {
    let (a_words, a_rest) = a.as_chunks::<8>();
    let (b_words, b_rest) = b.as_chunks::<8>();
    let whole: u32 = a_words
        .iter()
        .zip(b_words)
        .map(|(&x, &y)| (u64::from_le_bytes(x) ^ u64::from_le_bytes(y)).count_ones())
        .sum();
    let rest: u32 = a_rest.iter().zip(b_rest).map(|(&x, &y)| (x ^ y).count_ones()).sum();
    whole + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn vector_instructions_and_plain_loops_agree(
            seed in proptest::collection::vec(any::<u8>(), 1..70),
            rows in proptest::collection::vec(any::<u8>(), 0..700),
        ) {
            for kind in [DescriptorKind::Float, DescriptorKind::Binary] {
                let mut plain = vec![40_000; rows.len() / seed.len()];
                let mut vector = plain.clone();
                lower_plainly(kind, &seed, &rows, &mut plain);
                lower_distances(kind, &seed, &rows, &mut vector);
                prop_assert_eq!(vector, plain);
            }
        }
    }
}
