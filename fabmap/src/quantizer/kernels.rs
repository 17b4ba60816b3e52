//! Searches of float centres with the vector instructions of x86-64 processors.
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

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod vnni;

use super::float_panels::FloatPanels;
use super::lane_best::LaneBest;

/// Both searches with one set of instructions.
pub(super) struct FloatKernel {
    /// The best centre of each lane, for each row.
    pub(super) search: fn(&FloatPanels, &[u8], &mut [LaneBest]) -> bool,
    /// ‖c‖² − 2 x·c of each row for all centres and the padding of the last panel, row by row.
    pub(super) values: fn(&FloatPanels, &[u8], &mut [i32]) -> bool,
}

/// The fastest first.
pub(super) const FLOAT_KERNELS: [FloatKernel; 2] = [
    FloatKernel { search: vnni_search, values: vnni_values },
    FloatKernel { search: avx2_search, values: avx2_values },
];

/// [`FloatKernel::search`] with the fastest instructions that there are.
pub(super) fn float_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) -> bool {
    FLOAT_KERNELS.iter().any(|kernel| (kernel.search)(panels, rows, best))
}

/// [`FloatKernel::values`] with the fastest instructions that there are.
pub(super) fn float_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) -> bool {
    FLOAT_KERNELS.iter().any(|kernel| (kernel.values)(panels, rows, values))
}

/// Defines functions that run a kernel where the processor has what it needs.
macro_rules! where_possible {
    ($($name:ident($values:ty) = $kernel:path, if $possible:ident;)+) => {
        $(
            fn $name(panels: &FloatPanels, rows: &[u8], values: &mut [$values]) -> bool {
                #[cfg(target_arch = "x86_64")]
                if $possible() {
                    // SAFETY: this processor has all that the kernel needs.
                    unsafe { $kernel(panels, rows, values) };
                    return true;
                }
                let _ = (panels, rows, values);
                false
            }
        )+
    };
}

where_possible!(
    avx2_search(LaneBest) = avx2::search, if has_avx2;
    avx2_values(i32) = avx2::values, if has_avx2;
    vnni_search(LaneBest) = vnni::search, if has_vnni;
    vnni_values(i32) = vnni::values, if has_vnni;
);

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2")
}

#[cfg(target_arch = "x86_64")]
fn has_vnni() -> bool {
    is_x86_feature_detected!("avx512vnni")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx2")
}
