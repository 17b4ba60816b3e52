//! Asking for memory before it is needed.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "a prefetch is an intrinsic on an address; it reads nothing")
)]

/// Bytes that come from memory together.
const LINE_BYTES: usize = 64;

/// Has the processor fetch all of `values` into its first-level cache while it goes on; where that
/// cannot be asked for, nothing happens.
#[inline(always)]
pub(super) fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let first = values.as_ptr().cast::<i8>();
        let lines = (0..size_of_val(values)).step_by(LINE_BYTES);
        // SAFETY: the addresses lie within the slice, and prefetching reads none of them.
        lines.for_each(|offset| unsafe { _mm_prefetch::<_MM_HINT_T0>(first.add(offset)) });
    }
}
