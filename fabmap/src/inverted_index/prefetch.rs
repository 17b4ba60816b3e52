//! Asking for memory before it is needed.
#![cfg_attr(
    any(target_arch = "x86_64", target_arch = "aarch64"),
    expect(unsafe_code, reason = "a prefetch is an instruction on an address; it reads nothing")
)]

/// Bytes that come from memory together.
const LINE_BYTES: usize = 64;

/// Has the processor fetch all of `values` into its first-level cache while it goes on; where that
/// cannot be asked for, nothing happens.
#[inline(always)]
pub(super) fn prefetch<T>(values: &[T]) {
    let first = values.as_ptr().cast::<i8>();
    let lines = (0..size_of_val(values)).step_by(LINE_BYTES);
    lines.for_each(|offset| prefetch_line(first.wrapping_add(offset)));
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn prefetch_line(address: *const i8) {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
    // SAFETY: prefetching reads nothing.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(address) };
}

#[cfg(target_arch = "aarch64")]
#[inline(always)]
fn prefetch_line(address: *const i8) {
    // SAFETY: prefetching reads nothing. The intrinsic for it is not stable.
    unsafe {
        std::arch::asm!(
            "prfm pldl1keep, [{address}]",
            address = in(reg) address,
            options(nostack, preserves_flags, readonly),
        );
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
#[inline(always)]
fn prefetch_line(_address: *const i8) {}
