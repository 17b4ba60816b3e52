//! Sixteen centres as four registers of 128 bits, with the dot products that most ARM processors since 2018 have.
#![expect(
    unsafe_code,
    reason = "whole registers are read and written at once, and an instruction has no stable name"
)]

use std::arch::aarch64::{
    int32x4_t, uint8x16_t, uint32x4_t, vdupq_n_u8, vdupq_n_u32, vld1q_u8, vreinterpretq_s32_u32, vshlq_n_u32,
    vsubq_u32,
};
use std::arch::asm;

use super::neon::{improve, store_quarters, values_of};
use crate::quantizer::float_panels::{FloatPanels, LANES, PanelStep, Queries, STEP_DIMENSIONS};
use crate::quantizer::lane_best::LaneBest;

/// Rows whose four dimensions fill one register, and whose products stay in the 32 that there are.
const GROUP_ROWS: usize = 4;

#[target_feature(enable = "neon,dotprod")]
pub(super) fn search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    panels.visit(
        &Queries::<_, GROUP_ROWS>::pack(panels.width(), rows, unsigned),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| improve(&mut best[row], panel, values_of(constants, dots)),
    );
}

#[target_feature(enable = "neon,dotprod")]
pub(super) fn values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) {
    let (values, _) = values.as_chunks_mut::<LANES>();
    panels.visit(
        &Queries::<_, GROUP_ROWS>::pack(panels.width(), rows, unsigned),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| {
            store_quarters(&mut values[row * panels.panels() + panel], values_of(constants, dots));
        },
    );
}

/// The bytes as they were before 128 was taken away.
fn unsigned(dimensions: [i8; STEP_DIMENSIONS]) -> [u8; STEP_DIMENSIONS] {
    dimensions.map(|value| value.cast_unsigned() ^ 128)
}

/// These processors multiply bytes of one kind: (x − 128)·c = x·c − 128 Σc, whose last term is the
/// same for all rows.
#[inline]
#[target_feature(enable = "neon,dotprod")]
fn dots(group: &[[[u8; STEP_DIMENSIONS]; GROUP_ROWS]], panel: &[PanelStep]) -> [[int32x4_t; 4]; GROUP_ROWS] {
    let mut sums = [[vdupq_n_u32(0); 4]; GROUP_ROWS];
    let mut of_centres = [vdupq_n_u32(0); 4];
    let ones = vdupq_n_u8(1);
    for (queries, step) in group.iter().zip(panel) {
        // SAFETY: four rows of four dimensions have the sixteen bytes that are read.
        let queries = unsafe { vld1q_u8(queries.as_flattened().as_ptr()) };
        let (centres, _) = step.as_chunks::<16>();
        for (quarter, centres) in centres.iter().enumerate() {
            // SAFETY: a quarter of a step has sixteen bytes.
            let centres = unsafe { vld1q_u8(centres.as_ptr()) };
            of_centres[quarter] = add_dots::<0>(of_centres[quarter], centres, ones);
            sums[0][quarter] = add_dots::<0>(sums[0][quarter], centres, queries);
            sums[1][quarter] = add_dots::<1>(sums[1][quarter], centres, queries);
            sums[2][quarter] = add_dots::<2>(sums[2][quarter], centres, queries);
            sums[3][quarter] = add_dots::<3>(sums[3][quarter], centres, queries);
        }
    }
    sums.map(|sums| {
        std::array::from_fn(|quarter| {
            let less = vshlq_n_u32::<7>(of_centres[quarter]);
            vreinterpretq_s32_u32(vsubq_u32(sums[quarter], less))
        })
    })
}

/// Four dimensions of four centres and of row `ROW` make four sums of four products, which are added.
#[inline]
#[target_feature(enable = "neon,dotprod")]
fn add_dots<const ROW: u8>(sums: uint32x4_t, centres: uint8x16_t, rows: uint8x16_t) -> uint32x4_t {
    let mut added = sums;
    // SAFETY: it works on registers alone, and this processor knows it.
    unsafe {
        asm!(
            "udot {sums:v}.4s, {centres:v}.16b, {rows:v}.4b[{row}]",
            sums = inout(vreg) added,
            centres = in(vreg) centres,
            rows = in(vreg) rows,
            row = const ROW,
            options(pure, nomem, nostack, preserves_flags),
        );
    }
    added
}
