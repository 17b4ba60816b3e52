//! The same integer searches with the vector instructions of x86-64 processors.
//!
//! Each function says whether the processor could do it; if not, the caller takes the plain loop.
//! Everything is integer arithmetic without overflow, so both give the same result by construction
//! (and by property test).
#![cfg_attr(
    target_arch = "x86_64",
    expect(
        unsafe_code,
        reason = "code compiled for AVX2 or AVX-512 is called after asking the processor for it"
    )
)]

use super::binary_rows::BinaryRows;
use super::centres::Nearest;
use super::float_panels::{FloatPanels, LaneBest, Queries};
use crate::descriptor::DescriptorKind;

#[cfg(target_arch = "x86_64")]
mod kernels {
    use super::{BinaryRows, DescriptorKind, FloatPanels, LaneBest, Nearest, Queries};
    use crate::vocabulary::float_panels::{LANES, PanelStep, STEP_DIMENSIONS};
    use crate::vocabulary::seeding;
    use std::arch::x86_64::{
        __m256i, __m512i, _mm256_add_epi32, _mm256_and_si256, _mm256_blendv_epi8, _mm256_cmpgt_epi32,
        _mm256_loadu_si256, _mm256_madd_epi16, _mm256_min_epi32, _mm256_set1_epi16, _mm256_set1_epi32,
        _mm256_setzero_si256, _mm256_slli_epi32, _mm256_srli_epi16, _mm256_storeu_si256, _mm256_sub_epi32,
        _mm512_cmplt_epi32_mask, _mm512_dpbusd_epi32, _mm512_loadu_epi8, _mm512_loadu_epi32,
        _mm512_mask_set1_epi32, _mm512_min_epi32, _mm512_set1_epi32, _mm512_setzero_si512, _mm512_slli_epi32,
        _mm512_storeu_epi32, _mm512_sub_epi32,
    };

    /// Rows whose products AVX2 keeps in its 16 registers.
    const AVX2_GROUP: usize = 4;

    /// Rows whose products AVX-512 keeps in its 32 registers; as many as hide how long a
    /// multiplication takes.
    const VNNI_GROUP: usize = 12;

    #[target_feature(enable = "avx2")]
    pub(super) fn avx2_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
        match best.len() {
            1 => avx2_search_groups::<1>(panels, rows, best),
            _ => avx2_search_groups::<AVX2_GROUP>(panels, rows, best),
        }
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn avx2_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) {
        let (values, _) = values.as_chunks_mut::<LANES>();
        panels.visit(
            &Queries::<_, AVX2_GROUP>::pack(panels.width(), rows, pairs),
            |group, panel| avx2_dots(group, panel),
            |row, panel, constants, dots| {
                let found = avx2_values_of(constants, dots);
                store_halves(&mut values[row * panels.panels() + panel], found);
            },
        );
    }

    #[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
    pub(super) fn vnni_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
        match best.len() {
            1 => vnni_search_groups::<1>(panels, rows, best),
            _ => vnni_search_groups::<VNNI_GROUP>(panels, rows, best),
        }
    }

    #[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
    pub(super) fn vnni_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) {
        let (values, _) = values.as_chunks_mut::<LANES>();
        panels.visit(
            &Queries::<_, VNNI_GROUP>::pack(panels.width(), rows, |step| step),
            |group, panel| vnni_dots(group, panel),
            |row, panel, constants, dots| {
                let found = vnni_values_of(constants, dots);
                store(&mut values[row * panels.panels() + panel], found);
            },
        );
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn avx2_search_groups<const GROUP: usize>(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
        panels.visit(
            &Queries::<_, GROUP>::pack(panels.width(), rows, pairs),
            |group, panel| avx2_dots(group, panel),
            |row, panel, constants, dots| {
                let found = avx2_values_of(constants, dots);
                let panel = _mm256_set1_epi32(panel as i32);
                let LaneBest { values, panels } = &mut best[row];
                let (old, old_panels) = (halves(values), halves(panels));
                let lowest = |half: usize| _mm256_min_epi32(old[half], found[half]);
                let chosen = |half: usize| {
                    _mm256_blendv_epi8(old_panels[half], panel, _mm256_cmpgt_epi32(old[half], found[half]))
                };
                store_halves(values, [lowest(0), lowest(1)]);
                store_halves(panels, [chosen(0), chosen(1)]);
            },
        );
    }

    #[inline]
    #[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
    fn vnni_search_groups<const GROUP: usize>(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
        panels.visit(
            &Queries::<_, GROUP>::pack(panels.width(), rows, |step| step),
            |group, panel| vnni_dots(group, panel),
            |row, panel, constants, dots| {
                let found = vnni_values_of(constants, dots);
                let LaneBest { values, panels } = &mut best[row];
                let (old, old_panels) = (load(values), load(panels));
                let lower = _mm512_cmplt_epi32_mask(found, old);
                store(values, _mm512_min_epi32(found, old));
                store(panels, _mm512_mask_set1_epi32(old_panels, lower, panel as i32));
            },
        );
    }

    #[target_feature(enable = "avx2,popcnt")]
    pub(super) fn binary_nearest(centres: &BinaryRows, queries: &[u64], nearest: &mut [Nearest]) {
        centres.search(queries, nearest);
    }

    #[target_feature(enable = "avx2,popcnt")]
    pub(super) fn lower(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32]) {
        seeding::lower(kind, seed, rows, distances);
    }

    /// Dimensions 0 and 2 of a step widened to 16 bits, then 1 and 3.
    #[inline(always)]
    fn pairs([a, b, c, d]: [i8; STEP_DIMENSIONS]) -> [i32; 2] {
        let pair = |low: i8, high: i8| i32::from(low) & 0xffff | i32::from(high) << 16;
        [pair(a, c), pair(b, d)]
    }

    /// Two dimensions of eight centres and of one row make eight sums of two products in one
    /// instruction. Products of bytes are far from the 32-bit limit.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn avx2_dots<const GROUP: usize>(
        group: &[[[i32; 2]; GROUP]],
        panel: &[PanelStep],
    ) -> [[__m256i; 2]; GROUP] {
        let mut sums = [[_mm256_setzero_si256(); 2]; GROUP];
        for (queries, step) in group.iter().zip(panel) {
            let centres = eight_centres_each(step);
            for (query, sums) in queries.iter().zip(&mut sums) {
                let [even, odd] = query.map(|pair| _mm256_set1_epi32(pair));
                for (sum, (of_even, of_odd)) in sums.iter_mut().zip(centres) {
                    let products =
                        _mm256_add_epi32(_mm256_madd_epi16(even, of_even), _mm256_madd_epi16(odd, of_odd));
                    *sum = _mm256_add_epi32(*sum, products);
                }
            }
        }
        sums
    }

    /// Dimensions 0 and 2 of eight centres widened to 16 bits, and 1 and 3; then of the other eight.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn eight_centres_each(step: &PanelStep) -> [(__m256i, __m256i); 2] {
        let (halves, _) = step.as_chunks::<32>();
        std::array::from_fn(|half| {
            // SAFETY: half a step has the 32 bytes that are read.
            let bytes = unsafe { _mm256_loadu_si256(halves[half].as_ptr().cast()) };
            (_mm256_and_si256(bytes, _mm256_set1_epi16(0xff)), _mm256_srli_epi16::<8>(bytes))
        })
    }

    /// Four dimensions of sixteen centres and of one row make sixteen sums of four products in one
    /// instruction, which does not saturate.
    #[inline]
    #[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
    fn vnni_dots<const GROUP: usize>(
        group: &[[[i8; STEP_DIMENSIONS]; GROUP]],
        panel: &[PanelStep],
    ) -> [__m512i; GROUP] {
        let mut sums = [_mm512_setzero_si512(); GROUP];
        for (queries, step) in group.iter().zip(panel) {
            // SAFETY: a step has the 64 bytes that are read.
            let centres = unsafe { _mm512_loadu_epi8(step.as_ptr().cast()) };
            for (query, sum) in queries.iter().zip(&mut sums) {
                let query = i32::from_le_bytes(query.map(i8::cast_unsigned));
                *sum = _mm512_dpbusd_epi32(*sum, centres, _mm512_set1_epi32(query));
            }
        }
        sums
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn avx2_values_of(constants: &[i32; LANES], dots: [__m256i; 2]) -> [__m256i; 2] {
        let constants = halves(constants);
        std::array::from_fn(|half| _mm256_sub_epi32(constants[half], _mm256_slli_epi32::<1>(dots[half])))
    }

    #[inline]
    #[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
    fn vnni_values_of(constants: &[i32; LANES], dots: __m512i) -> __m512i {
        _mm512_sub_epi32(load(constants), _mm512_slli_epi32::<1>(dots))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn halves(lanes: &[i32; LANES]) -> [__m256i; 2] {
        let (halves, _) = lanes.as_chunks::<8>();
        // SAFETY: a half has the eight lanes that are read.
        std::array::from_fn(|half| unsafe { _mm256_loadu_si256(halves[half].as_ptr().cast()) })
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn store_halves(lanes: &mut [i32; LANES], values: [__m256i; 2]) {
        let (halves, _) = lanes.as_chunks_mut::<8>();
        for (half, value) in halves.iter_mut().zip(values) {
            // SAFETY: a half has the eight lanes that are written.
            unsafe { _mm256_storeu_si256(half.as_mut_ptr().cast(), value) };
        }
    }

    #[inline]
    #[target_feature(enable = "avx2,avx512f")]
    fn load(lanes: &[i32; LANES]) -> __m512i {
        // SAFETY: there are the sixteen lanes that are read.
        unsafe { _mm512_loadu_epi32(lanes.as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx2,avx512f")]
    fn store(lanes: &mut [i32; LANES], values: __m512i) {
        // SAFETY: there are the sixteen lanes that are written.
        unsafe { _mm512_storeu_epi32(lanes.as_mut_ptr(), values) };
    }
}

/// Defines functions that run the kernels of the same name where the processor has what they need.
macro_rules! where_possible {
    ($possible:ident: $($name:ident($($argument:ident: $type:ty),*);)+) => {
        $(
            pub(super) fn $name($($argument: $type),*) -> bool {
                #[cfg(target_arch = "x86_64")]
                if $possible() {
                    // SAFETY: this processor has all that the kernel needs.
                    unsafe { kernels::$name($($argument),*) };
                    return true;
                }
                let _ = ($($argument),*);
                false
            }
        )+
    };
}

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("popcnt")
}

#[cfg(target_arch = "x86_64")]
fn has_vnni() -> bool {
    std::arch::is_x86_feature_detected!("avx512vnni")
        && std::arch::is_x86_feature_detected!("avx512bw")
        && std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx2")
}

where_possible!(has_avx2:
    avx2_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]);
    avx2_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]);
    binary_nearest(centres: &BinaryRows, queries: &[u64], nearest: &mut [Nearest]);
    lower(kind: DescriptorKind, seed: &[u8], rows: &[u8], distances: &mut [u32]);
);
where_possible!(has_vnni:
    vnni_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]);
    vnni_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]);
);

/// [`FloatPanels::search`] and [`FloatPanels::values`] with one set of instructions.
pub(super) struct FloatKernel {
    pub(super) search: fn(&FloatPanels, &[u8], &mut [LaneBest]) -> bool,
    pub(super) values: fn(&FloatPanels, &[u8], &mut [i32]) -> bool,
}

/// The fastest first.
pub(super) const FLOAT_KERNELS: [FloatKernel; 2] = [
    FloatKernel { search: vnni_search, values: vnni_values },
    FloatKernel { search: avx2_search, values: avx2_values },
];

/// [`FloatPanels::search`] with the fastest instructions that there are.
pub(super) fn float_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) -> bool {
    FLOAT_KERNELS.iter().any(|kernel| (kernel.search)(panels, rows, best))
}

/// [`FloatPanels::values`] with the fastest instructions that there are.
pub(super) fn float_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) -> bool {
    FLOAT_KERNELS.iter().any(|kernel| (kernel.values)(panels, rows, values))
}
