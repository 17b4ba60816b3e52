//! Sixteen centres as one register of 512 bits.
#![expect(unsafe_code, reason = "whole registers are read and written at once")]

use std::arch::x86_64::{
    __m512i, _mm512_cmplt_epi32_mask, _mm512_dpbusd_epi32, _mm512_loadu_epi8, _mm512_loadu_epi32,
    _mm512_mask_set1_epi32, _mm512_min_epi32, _mm512_set1_epi32, _mm512_setzero_si512, _mm512_slli_epi32,
    _mm512_storeu_epi32, _mm512_sub_epi32,
};

use crate::quantizer::float_panels::{FloatPanels, LANES, PanelStep, Queries, STEP_DIMENSIONS};
use crate::quantizer::lane_best::LaneBest;

/// Rows whose products AVX-512 keeps in its 32 registers; as many as hide how long a multiplication
/// takes.
const GROUP_ROWS: usize = 12;

#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
pub(super) fn search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    match best.len() {
        1 => search_groups::<1>(panels, rows, best),
        _ => search_groups::<GROUP_ROWS>(panels, rows, best),
    }
}

#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
pub(super) fn values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) {
    let (values, _) = values.as_chunks_mut::<LANES>();
    panels.visit(
        &Queries::<_, GROUP_ROWS>::pack(panels.width(), rows, |step| step),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| {
            let found = values_of(constants, dots);
            store(&mut values[row * panels.panels() + panel], found);
        },
    );
}

#[inline]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
fn search_groups<const GROUP: usize>(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    panels.visit(
        &Queries::<_, GROUP>::pack(panels.width(), rows, |step| step),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| {
            let found = values_of(constants, dots);
            let LaneBest { values, panels } = &mut best[row];
            let (old, old_panels) = (load(values), load(panels));
            let lower = _mm512_cmplt_epi32_mask(found, old);
            store(values, _mm512_min_epi32(found, old));
            store(panels, _mm512_mask_set1_epi32(old_panels, lower, panel as i32));
        },
    );
}

/// Four dimensions of sixteen centres and of one row make sixteen sums of four products in one
/// instruction, which does not saturate.
#[inline]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
fn dots<const GROUP: usize>(
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
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vnni")]
fn values_of(constants: &[i32; LANES], dots: __m512i) -> __m512i {
    _mm512_sub_epi32(load(constants), _mm512_slli_epi32::<1>(dots))
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
