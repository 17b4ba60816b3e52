//! A target in libFuzzer's hands; `WAYPOST_FUZZ_TARGET` names it. `scripts/fuzz` builds and runs this.
#![no_main]
#![allow(unsafe_code, reason = "libFuzzer is called by names that are not mangled")]
#![allow(clippy::expect_used, reason = "a fuzzer ends where something is wrong")]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use waypost_fuzz::{Target, memory, named};

#[global_allocator]
static ALLOCATOR: memory::Counting = memory::Counting;

/// What one input may take: see `tests/corpora`.
const MOST_BYTES: usize = 256 << 20;

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("WAYPOST_FUZZ_TARGET").expect("WAYPOST_FUZZ_TARGET names a target");
    named(&name).expect("a target has that name")
});

fuzz_target!(|bytes: &[u8]| {
    let (_fed, peak) = memory::peak_of(|| (TARGET.feed)(bytes));
    assert!(peak <= MOST_BYTES, "an input of {} bytes took {peak} bytes of memory", bytes.len());
});
