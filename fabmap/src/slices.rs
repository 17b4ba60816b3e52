//! Exponentials, logarithms, sums and maxima of whole slices.
//!
//! Written without branches, so that the compiler makes vector code of them, for the widest
//! registers that the processor has. Each lane does the same operations in the same order whatever
//! the width, so all processors give the same bits.
#![cfg_attr(
    target_arch = "x86_64",
    expect(
        unsafe_code,
        reason = "code compiled for AVX2 and AVX-512 is called after asking the processor for it"
    )
)]

use std::f64::consts::{LN_2, LOG2_E, SQRT_2};

/// Partial sums that are kept apart: enough to fill two of the widest registers.
const LANES: usize = 16;

/// Makes `$name` the function for any processor that runs `$body` compiled for this one.
macro_rules! for_this_processor {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)? = $body:ident) => {
        $(#[$doc])*
        $visibility fn $name($($argument: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512dq")]
                fn avx512($($argument: $type),*) $(-> $result)? { $body($($argument),*) }
                #[target_feature(enable = "avx2")]
                fn avx2($($argument: $type),*) $(-> $result)? { $body($($argument),*) }
                if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
                    // SAFETY: the processor has just said that it has these instructions.
                    return unsafe { avx512($($argument),*) };
                }
                if is_x86_feature_detected!("avx2") {
                    // SAFETY: as above.
                    return unsafe { avx2($($argument),*) };
                }
            }
            $body($($argument),*)
        }
    };
}

for_this_processor! {
    /// exp((x - origin) · scale) of every x, and the sum of them, in one order whatever the
    /// processor. Within 2e-15 of the exact value, relatively; what is below e^-708 is 0, and
    /// arguments must be below 700.
    pub(crate) fn exponentials(values: &[f64], origin: f64, scale: f64, results: &mut [f64]) -> f64 = plain_exponentials
}

for_this_processor! {
    /// ln((p[0] a + p[1] b) / (q[0] a + q[1] b)) of every pair (a, b); both sums must be normal and
    /// above 0.
    pub(crate) fn log_ratios(pairs: &[[f64; 2]], p: [f64; 2], q: [f64; 2], results: &mut [f64]) = plain_log_ratios
}

for_this_processor! {
    /// The largest value; -∞ of none.
    pub(crate) fn largest(values: &[f64]) -> f64 = plain_largest
}

for_this_processor! {
    /// The sum, in one order whatever the processor.
    pub(crate) fn sum(values: &[f64]) -> f64 = plain_sum
}

for_this_processor! {
    /// x ← x · factor + offset.
    pub(crate) fn scale(values: &mut [f64], factor: f64, offset: f64) = plain_scale
}

#[inline(always)]
fn plain_exponentials(values: &[f64], origin: f64, scale: f64, results: &mut [f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let mut rest = 0.0;
    let (chunks, last) = values.as_chunks::<LANES>();
    let (result_chunks, result_last) = results.as_chunks_mut::<LANES>();
    for (values, results) in chunks.iter().zip(result_chunks) {
        for lane in 0..LANES {
            results[lane] = exponential((values[lane] - origin) * scale);
            sums[lane] += results[lane];
        }
    }
    for (value, result) in last.iter().zip(result_last) {
        *result = exponential((value - origin) * scale);
        rest += *result;
    }
    sums.iter().sum::<f64>() + rest
}

#[inline(always)]
fn plain_log_ratios(pairs: &[[f64; 2]], p: [f64; 2], q: [f64; 2], results: &mut [f64]) {
    for (&[a, b], result) in pairs.iter().zip(results) {
        *result = logarithm((p[0] * a + p[1] * b) / (q[0] * a + q[1] * b));
    }
}

#[inline(always)]
fn plain_largest(values: &[f64]) -> f64 {
    let mut largest = [f64::NEG_INFINITY; LANES];
    let (chunks, last) = values.as_chunks::<LANES>();
    for values in chunks {
        for lane in 0..LANES {
            largest[lane] = if values[lane] > largest[lane] { values[lane] } else { largest[lane] };
        }
    }
    largest.iter().chain(last).copied().fold(f64::NEG_INFINITY, f64::max)
}

#[inline(always)]
fn plain_sum(values: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (chunks, last) = values.as_chunks::<LANES>();
    for values in chunks {
        for lane in 0..LANES {
            sums[lane] += values[lane];
        }
    }
    sums.iter().sum::<f64>() + last.iter().sum::<f64>()
}

#[inline(always)]
fn plain_scale(values: &mut [f64], factor: f64, offset: f64) {
    values.iter_mut().for_each(|value| *value = *value * factor + offset);
}

/// Added to a small number it leaves that number, rounded, in the last bits of the mantissa.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// Bits of ln 2 that are exact when multiplied by any binary exponent, and the rest of them.
const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
const LN_2_LOW: f64 = f64::from_bits(0x3dea_39ef_3579_3c76);

/// e^x = 2^n e^r with |r| ≤ ln 2 / 2, and Taylor's series of e^r.
#[inline(always)]
fn exponential(x: f64) -> f64 {
    let rounded = x.max(-708.0) * LOG2_E + ROUNDER;
    let n = rounded - ROUNDER;
    let r = (x.max(-708.0) - n * LN_2_HIGH) - n * LN_2_LOW;
    const COEFFICIENTS: [f64; 13] = taylor_coefficients();
    let mut series = COEFFICIENTS[0];
    for coefficient in &COEFFICIENTS[1..] {
        series = series * r + coefficient;
    }
    let scaled = f64::from_bits((series * r + 1.0).to_bits().wrapping_add(rounded.to_bits() << 52));
    if x < -708.0 { 0.0 } else { scaled }
}

/// 1/13!, 1/12!, …, 1.
const fn taylor_coefficients() -> [f64; 13] {
    let mut coefficients = [1.0; 13];
    let mut factorial = 1.0;
    let mut order = 1;
    while order <= 13 {
        factorial *= order as f64;
        coefficients[13 - order] = 1.0 / factorial;
        order += 1;
    }
    coefficients
}

/// ln x = n ln 2 + 2 artanh((m - 1) / (m + 1)), x = 2^n m with √½ ≤ m < √2.
#[inline(always)]
fn logarithm(x: f64) -> f64 {
    // n + 1022, as an integer: how often 2 fits above √½ · 2^-1022.
    let above = x.to_bits().wrapping_sub((SQRT_2 / 2.0).to_bits() - (1022 << 52)) >> 52;
    let m = f64::from_bits(x.to_bits().wrapping_sub(above << 52).wrapping_add(1022 << 52));
    let n = f64::from_bits(ROUNDER.to_bits() + above) - ROUNDER - 1022.0;
    let s = (m - 1.0) / (m + 1.0);
    let squared = s * s;
    const TERMS: usize = 12;
    let mut series = 1.0 / (2 * TERMS + 1) as f64;
    for term in (0..TERMS).rev() {
        series = series * squared + 1.0 / (2 * term + 1) as f64;
    }
    n * LN_2 + 2.0 * s * series
}

#[cfg(test)]
mod tests;
