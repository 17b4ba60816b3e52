//! The same integer searches with the vector instructions of x86-64 processors.
//!
//! Each function says whether the processor could do it; if not, the caller takes the plain loop.
//! Everything is integer arithmetic without overflow, so both give the same result by construction
//! (and by property test).
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "code compiled for AVX2 is called after asking the processor for it")
)]

use super::binary_rows::BinaryRows;
use super::centres::Nearest;
use super::float_panels::{FloatPanels, LaneBest, Queries};
use crate::descriptor::DescriptorKind;

#[cfg(target_arch = "x86_64")]
mod kernels {
    use super::{BinaryRows, DescriptorKind, FloatPanels, LaneBest, Nearest, Queries};
    use crate::vocabulary::float_panels::{Dots, GROUP, LANES, PanelStep};
    use crate::vocabulary::seeding;
    use std::arch::x86_64::{
        __m128i, __m256i, _mm_set_epi64x, _mm256_add_epi32, _mm256_cvtepu8_epi16, _mm256_extract_epi32,
        _mm256_madd_epi16, _mm256_set1_epi32, _mm256_setzero_si256,
    };

    #[target_feature(enable = "avx2")]
    pub(super) fn float_nearest(panels: &FloatPanels, queries: &Queries, best: &mut [LaneBest]) {
        panels.search(
            queries,
            best,
            |rows, panel| dots::<GROUP>(rows, panel),
            |rows, panel| dots::<1>(rows, panel),
        );
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn float_values(panels: &FloatPanels, query: &Queries, values: &mut Vec<i32>) {
        panels.values(query, values, |rows, panel| dots::<1>(rows, panel));
    }

    #[target_feature(enable = "avx2,popcnt")]
    pub(super) fn binary_nearest(centres: &BinaryRows, queries: &[u64], nearest: &mut [Nearest]) {
        centres.search(queries, nearest);
    }

    #[target_feature(enable = "avx2,popcnt")]
    pub(super) fn lower(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32]) {
        seeding::lower(kind, seed, rows, distances);
    }

    /// Two dimensions of eight centres and of one row make eight sums of two products in one
    /// instruction. Values are below 256, so products and sums are far from the 32-bit limit.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn dots<const ROWS: usize>(rows: [&[i32]; ROWS], panel: &[PanelStep]) -> [Dots; ROWS] {
        let mut sums = [[_mm256_setzero_si256(); 2]; ROWS];
        for (index, step) in panel.iter().enumerate() {
            let (low, high) = (widened(step, 0), widened(step, LANES));
            for (row, sums) in rows.iter().zip(&mut sums) {
                let pair = _mm256_set1_epi32(row[index]);
                sums[0] = _mm256_add_epi32(sums[0], _mm256_madd_epi16(pair, low));
                sums[1] = _mm256_add_epi32(sums[1], _mm256_madd_epi16(pair, high));
            }
        }
        sums.map(|[low, high]| {
            let (low, high) = (lanes(low), lanes(high));
            std::array::from_fn(|lane| if lane < 8 { low[lane] } else { high[lane - 8] })
        })
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn widened(step: &PanelStep, start: usize) -> __m256i {
        let half = |at: usize| i64::from_le_bytes(std::array::from_fn(|byte| step[at + byte]));
        let bytes: __m128i = _mm_set_epi64x(half(start + 8), half(start));
        _mm256_cvtepu8_epi16(bytes)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn lanes(vector: __m256i) -> [i32; 8] {
        [
            _mm256_extract_epi32::<0>(vector),
            _mm256_extract_epi32::<1>(vector),
            _mm256_extract_epi32::<2>(vector),
            _mm256_extract_epi32::<3>(vector),
            _mm256_extract_epi32::<4>(vector),
            _mm256_extract_epi32::<5>(vector),
            _mm256_extract_epi32::<6>(vector),
            _mm256_extract_epi32::<7>(vector),
        ]
    }
}

/// Defines a function that runs the kernel of the same name where the processor has what it needs.
macro_rules! where_possible {
    ($(#[$meta:meta])* $name:ident($($argument:ident: $type:ty),*)) => {
        $(#[$meta])*
        pub(super) fn $name($($argument: $type),*) -> bool {
            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("popcnt") {
                // SAFETY: the kernels need AVX2 and POPCNT, and this processor has both.
                unsafe { kernels::$name($($argument),*) };
                return true;
            }
            let _ = ($($argument),*);
            false
        }
    };
}

where_possible!(
    /// [`FloatPanels::search`].
    float_nearest(panels: &FloatPanels, queries: &Queries, best: &mut [LaneBest])
);
where_possible!(
    /// [`FloatPanels::values`].
    float_values(panels: &FloatPanels, query: &Queries, values: &mut Vec<i32>)
);
where_possible!(
    /// [`BinaryRows::search`].
    binary_nearest(centres: &BinaryRows, queries: &[u64], nearest: &mut [Nearest])
);
where_possible!(
    /// [`super::seeding::lower`].
    lower(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32])
);
