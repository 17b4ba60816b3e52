//! Memory that is no longer needed goes back to the system.

/// What was freed in many small pieces, as by the decoding of images, stays with this process unless it is told to give
/// that back.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "the C library has no safe name for it")]
pub(crate) fn give_back() {
    // SAFETY: it takes no pointer, may be called from any thread at any time, and moves nothing that is in use.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Other C libraries do so by themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(crate) fn give_back() {}
