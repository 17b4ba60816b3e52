//! Searches of float centres with the vector instructions of x86-64 and of ARM processors of 64 bits.
//!
//! Each function says whether the processor could do it; if not, the caller takes the plain loop.
//! Everything is integer arithmetic without overflow, so all give the same result by construction
//! (and by property test).
#![cfg_attr(
    any(target_arch = "x86_64", target_arch = "aarch64"),
    expect(unsafe_code, reason = "code compiled for some processors is called after asking this one")
)]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod dotprod;
#[cfg(target_arch = "aarch64")]
mod neon;
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

/// [`FloatKernel::search`] with the fastest instructions that there are.
pub(super) fn float_search(panels: &FloatPanels, rows: &[u8], best: &mut [LaneBest]) -> bool {
    FLOAT_KERNELS.iter().any(|kernel| (kernel.search)(panels, rows, best))
}

/// [`FloatKernel::values`] with the fastest instructions that there are.
pub(super) fn float_values(panels: &FloatPanels, rows: &[u8], values: &mut [i32]) -> bool {
    FLOAT_KERNELS.iter().any(|kernel| (kernel.values)(panels, rows, values))
}

/// A kernel, run where the processor has what it needs.
macro_rules! where_possible {
    ($kernel:ident, if $possible:expr) => {
        FloatKernel {
            search: |panels, rows, best| {
                let possible = $possible;
                if possible {
                    // SAFETY: this processor has all that the kernel needs.
                    unsafe { $kernel::search(panels, rows, best) };
                }
                possible
            },
            values: |panels, rows, values| {
                let possible = $possible;
                if possible {
                    // SAFETY: as above.
                    unsafe { $kernel::values(panels, rows, values) };
                }
                possible
            },
        }
    };
}

/// The fastest first.
#[cfg(target_arch = "x86_64")]
pub(super) const FLOAT_KERNELS: &[FloatKernel] =
    &[where_possible!(vnni, if has_vnni()), where_possible!(avx2, if is_x86_feature_detected!("avx2"))];

/// The fastest first.
#[cfg(target_arch = "aarch64")]
pub(super) const FLOAT_KERNELS: &[FloatKernel] = &[
    where_possible!(dotprod, if std::arch::is_aarch64_feature_detected!("dotprod")),
    where_possible!(neon, if std::arch::is_aarch64_feature_detected!("neon")),
];

/// None is known of other processors.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub(super) const FLOAT_KERNELS: &[FloatKernel] = &[];

#[cfg(target_arch = "x86_64")]
fn has_vnni() -> bool {
    is_x86_feature_detected!("avx512vnni")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx2")
}
