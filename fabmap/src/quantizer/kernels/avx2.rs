//! Sixteen centres as two registers of 256 bits.
#![expect(unsafe_code, reason = "whole registers are read and written at once")]

use std::arch::x86_64::{
    __m256i, _mm256_add_epi32, _mm256_and_si256, _mm256_blendv_epi8, _mm256_cmpgt_epi32, _mm256_loadu_si256,
    _mm256_madd_epi16, _mm256_min_epi32, _mm256_set1_epi16, _mm256_set1_epi32, _mm256_setzero_si256,
    _mm256_slli_epi32, _mm256_srli_epi16, _mm256_storeu_si256, _mm256_sub_epi32,
};

use crate::quantizer::float_panels::{FloatPanels, LANES, PanelStep, Queries, STEP_DIMENSIONS};
use crate::quantizer::lane_best::LaneBest;

/// Rows whose products AVX2 keeps in its 16 registers.
const GROUP_ROWS: usize = 4;

#[target_feature(enable = "avx2")]
pub(super) fn search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    match best.len() {
        1 => search_groups::<1>(panels, rows, best),
        _ => search_groups::<GROUP_ROWS>(panels, rows, best),
    }
}

#[target_feature(enable = "avx2")]
pub(super) fn values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) {
    let (values, _) = values.as_chunks_mut::<LANES>();
    panels.visit(
        &Queries::<_, GROUP_ROWS>::pack(panels.width(), rows, pairs),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| {
            let found = values_of(constants, dots);
            store_halves(&mut values[row * panels.panels() + panel], found);
        },
    );
}

#[inline]
#[target_feature(enable = "avx2")]
fn search_groups<const GROUP: usize>(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    panels.visit(
        &Queries::<_, GROUP>::pack(panels.width(), rows, pairs),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| {
            let found = values_of(constants, dots);
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
fn dots<const GROUP: usize>(group: &[[[i32; 2]; GROUP]], panel: &[PanelStep]) -> [[__m256i; 2]; GROUP] {
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

#[inline]
#[target_feature(enable = "avx2")]
fn values_of(constants: &[i32; LANES], dots: [__m256i; 2]) -> [__m256i; 2] {
    let constants = halves(constants);
    std::array::from_fn(|half| _mm256_sub_epi32(constants[half], _mm256_slli_epi32::<1>(dots[half])))
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
