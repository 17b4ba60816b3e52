//! A small file that claims to be a huge image costs no memory. Alone in its process, so that what
//! is measured is the decoder's doing.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod scenes;

use waypost_vision::image::{ImageError, decode};

#[test]
fn a_decompression_bomb_is_refused_without_allocating() {
    let bombs = [scenes::png_claiming(30_000, 30_000), scenes::jpeg_claiming(60_000, 60_000)];
    decode(&scenes::textured(640, 480, 1).encode_jpeg(90).unwrap()).unwrap();

    let before = peak_address_space_kib();
    for bomb in &bombs {
        assert!(matches!(decode(bomb), Err(ImageError::TooLarge { .. })));
    }
    let grown = peak_address_space_kib() - before;
    // One byte a pixel would be 878,906 KiB.
    assert!(grown < 16 * 1024, "the address space grew by {grown} KiB");
}

/// The most address space this process has had, reserved but untouched memory included.
fn peak_address_space_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:")).unwrap();
    line.trim().trim_end_matches(" kB").trim().parse().unwrap()
}
