//! Sixteen centres as four registers of 128 bits, on any ARM processor of 64 bits.
#![expect(unsafe_code, reason = "whole registers are read and written at once")]

use std::arch::aarch64::{
    int16x8_t, int32x4_t, uint8x16_t, vbslq_s32, vcgtq_s32, vdupq_n_s32, vget_low_s16, vget_low_u8, vld1_s16,
    vld1q_s32, vld4q_u8, vminq_s32, vmlal_high_lane_s16, vmlal_lane_s16, vmlsq_n_s32, vmovl_high_u8,
    vmovl_u8, vreinterpretq_s16_u16, vst1q_s32,
};

use crate::quantizer::float_panels::{FloatPanels, LANES, PanelStep, Queries, STEP_DIMENSIONS};
use crate::quantizer::lane_best::LaneBest;

/// Rows whose products stay in the 32 registers.
const GROUP_ROWS: usize = 4;

#[target_feature(enable = "neon")]
pub(super) fn search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    match best.len() {
        1 => search_groups::<1>(panels, rows, best),
        _ => search_groups::<GROUP_ROWS>(panels, rows, best),
    }
}

#[target_feature(enable = "neon")]
pub(super) fn values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) {
    let (values, _) = values.as_chunks_mut::<LANES>();
    panels.visit(
        &Queries::<_, GROUP_ROWS>::pack(panels.width(), rows, widened),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| {
            store_quarters(&mut values[row * panels.panels() + panel], values_of(constants, dots));
        },
    );
}

#[inline]
#[target_feature(enable = "neon")]
fn search_groups<const GROUP: usize>(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) {
    panels.visit(
        &Queries::<_, GROUP>::pack(panels.width(), rows, widened),
        |group, panel| dots(group, panel),
        |row, panel, constants, dots| improve(&mut best[row], panel, values_of(constants, dots)),
    );
}

fn widened(dimensions: [i8; STEP_DIMENSIONS]) -> [i16; STEP_DIMENSIONS] {
    dimensions.map(i16::from)
}

/// One dimension of all sixteen centres at a time, widened to 16 bits.
#[inline]
#[target_feature(enable = "neon")]
fn dots<const GROUP: usize>(
    group: &[[[i16; STEP_DIMENSIONS]; GROUP]],
    panel: &[PanelStep],
) -> [[int32x4_t; 4]; GROUP] {
    let mut sums = [[vdupq_n_s32(0); 4]; GROUP];
    for (queries, step) in group.iter().zip(panel) {
        // SAFETY: a step has the 64 bytes that are read.
        let dimensions = unsafe { vld4q_u8(step.as_ptr()) };
        for (query, sums) in queries.iter().zip(&mut sums) {
            add_products::<0>(sums, dimensions.0, query);
            add_products::<1>(sums, dimensions.1, query);
            add_products::<2>(sums, dimensions.2, query);
            add_products::<3>(sums, dimensions.3, query);
        }
    }
    sums
}

#[inline]
#[target_feature(enable = "neon")]
fn add_products<const DIMENSION: i32>(
    sums: &mut [int32x4_t; 4],
    centres: uint8x16_t,
    query: &[i16; STEP_DIMENSIONS],
) {
    // SAFETY: there are the four values that are read.
    let query = unsafe { vld1_s16(query.as_ptr()) };
    let low: int16x8_t = vreinterpretq_s16_u16(vmovl_u8(vget_low_u8(centres)));
    let high: int16x8_t = vreinterpretq_s16_u16(vmovl_high_u8(centres));
    let [first, second, third, fourth] = *sums;
    *sums = [
        vmlal_lane_s16::<DIMENSION>(first, vget_low_s16(low), query),
        vmlal_high_lane_s16::<DIMENSION>(second, low, query),
        vmlal_lane_s16::<DIMENSION>(third, vget_low_s16(high), query),
        vmlal_high_lane_s16::<DIMENSION>(fourth, high, query),
    ];
}

#[inline]
#[target_feature(enable = "neon")]
pub(super) fn values_of(constants: &[i32; LANES], dots: [int32x4_t; 4]) -> [int32x4_t; 4] {
    let constants = quarters(constants);
    std::array::from_fn(|quarter| vmlsq_n_s32(constants[quarter], dots[quarter], 2))
}

/// [`LaneBest::improve`], in registers.
#[inline]
#[target_feature(enable = "neon")]
pub(super) fn improve(best: &mut LaneBest, panel: usize, found: [int32x4_t; 4]) {
    let panel = vdupq_n_s32(panel as i32);
    let LaneBest { values, panels } = best;
    let (old, old_panels) = (quarters(values), quarters(panels));
    let lowest = |quarter: usize| vminq_s32(old[quarter], found[quarter]);
    let chosen =
        |quarter: usize| vbslq_s32(vcgtq_s32(old[quarter], found[quarter]), panel, old_panels[quarter]);
    store_quarters(values, std::array::from_fn(lowest));
    store_quarters(panels, std::array::from_fn(chosen));
}

#[inline]
#[target_feature(enable = "neon")]
fn quarters(lanes: &[i32; LANES]) -> [int32x4_t; 4] {
    let (quarters, _) = lanes.as_chunks::<4>();
    // SAFETY: a quarter has the four lanes that are read.
    std::array::from_fn(|quarter| unsafe { vld1q_s32(quarters[quarter].as_ptr()) })
}

#[inline]
#[target_feature(enable = "neon")]
pub(super) fn store_quarters(lanes: &mut [i32; LANES], values: [int32x4_t; 4]) {
    let (quarters, _) = lanes.as_chunks_mut::<4>();
    for (quarter, value) in quarters.iter_mut().zip(values) {
        // SAFETY: a quarter has the four lanes that are written.
        unsafe { vst1q_s32(quarter.as_mut_ptr(), value) };
    }
}
