//! Pictures to look at: made up, but with texture at every scale, and the same on every run.
#![allow(dead_code, reason = "each test binary uses a part of it")]

use std::io::Cursor;

use image::{DynamicImage, ImageFormat};
use waypost_vision::image::GreyImage;

/// Overlapping soft-edged discs of random place, size and brightness on mid grey.
pub(crate) fn textured(width: u32, height: u32, seed: u64) -> GreyImage {
    let mut random = Random(seed.wrapping_mul(2).wrapping_add(1));
    let discs: Vec<Disc> = (0..u64::from(width) * u64::from(height) / 400)
        .map(|_| Disc {
            x: random.below(width),
            y: random.below(height),
            radius: 2.0 + 10.0 * random.unit().powi(3),
            grey: 255.0 * random.unit(),
        })
        .collect();
    draw(width, height, 128.0, &discs)
}

pub(crate) struct Disc {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) radius: f64,
    pub(crate) grey: f64,
}

/// Draws the discs in order over a uniform ground, their edges one pixel soft.
pub(crate) fn draw(width: u32, height: u32, ground: f64, discs: &[Disc]) -> GreyImage {
    let (columns, rows) = (width as usize, height as usize);
    let mut levels = vec![ground; columns * rows];
    for disc in discs {
        let reach = disc.radius + 1.0;
        let (left, right) = ((disc.x - reach).max(0.0) as usize, (disc.x + reach) as usize);
        let (top, bottom) = ((disc.y - reach).max(0.0) as usize, (disc.y + reach) as usize);
        for y in top..=bottom.min(rows - 1) {
            for x in left..=right.min(columns - 1) {
                let distance = (x as f64 - disc.x).hypot(y as f64 - disc.y);
                let cover = (disc.radius + 0.5 - distance).clamp(0.0, 1.0);
                let level = &mut levels[y * columns + x];
                *level += cover * (disc.grey - *level);
            }
        }
    }
    GreyImage::new(width, height, levels.iter().map(|level| level.round() as u8).collect()).unwrap()
}

/// The part of `image` that starts at (`left`, `top`).
pub(crate) fn crop(image: &GreyImage, left: u32, top: u32, width: u32, height: u32) -> GreyImage {
    let pixels = image
        .pixels()
        .chunks_exact(image.width() as usize)
        .skip(top as usize)
        .take(height as usize)
        .flat_map(|row| row[left as usize..(left + width) as usize].to_vec())
        .collect();
    GreyImage::new(width, height, pixels).unwrap()
}

/// A real PNG whose header, checksum included, is rewritten to claim another size.
pub(crate) fn png_claiming(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::new_luma8(64, 64).write_to(&mut bytes, ImageFormat::Png).unwrap();
    let mut png = bytes.into_inner();
    png[16..20].copy_from_slice(&width.to_be_bytes());
    png[20..24].copy_from_slice(&height.to_be_bytes());
    let checksum = crc32(&png[12..29]);
    png[29..33].copy_from_slice(&checksum.to_be_bytes());
    png
}

/// A real JPEG whose frame header is rewritten to claim another size.
pub(crate) fn jpeg_claiming(width: u16, height: u16) -> Vec<u8> {
    let mut jpeg = textured(64, 64, 11).encode_jpeg(80).unwrap();
    let frame_header = jpeg.windows(2).position(|marker| marker == b"\xff\xc0").unwrap();
    jpeg[frame_header + 5..frame_header + 7].copy_from_slice(&height.to_be_bytes());
    jpeg[frame_header + 7..frame_header + 9].copy_from_slice(&width.to_be_bytes());
    jpeg
}

/// The checksum of PNG chunks (W3C PNG specification, annex D).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 * (crc & 1)))
    })
}

/// Xorshift64: enough for pictures.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, limit: u32) -> f64 {
        f64::from(limit) * self.unit()
    }
}
