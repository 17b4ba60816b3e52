//! How large an image may be.

/// Largest encoded image that is looked at, in bytes (4 MiB).
pub const MAX_ENCODED_BYTES: usize = 4 * 1024 * 1024;

/// Largest image that is decoded, in pixels (16 megapixels).
pub const MAX_PIXELS: u64 = 16_000_000;

/// Shortest side in which features can be looked for, in pixels.
pub const MIN_SIDE_PX: u32 = 16;

/// Longest side of an image that is decoded, in pixels: what a JPEG can say, so that a thumbnail
/// can be made of it.
pub const MAX_SIDE_PX: u32 = 65_535;

/// Most that a decoder may allocate, in bytes: the largest image as 16-bit RGBA, and an eighth more
/// for rows, tables and colour profiles.
pub(super) const MAX_DECODER_BYTES: u64 = MAX_PIXELS * 8 + MAX_PIXELS;
