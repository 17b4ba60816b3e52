//! Photos as a server takes them: larger ones are made smaller here.

use std::io::{BufRead, Cursor, Seek};

use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader, ImageResult};
use waypost_client::MAX_IMAGE_BYTES;

/// Pixels that a server takes at most.
pub(crate) const MOST_PIXELS: u64 = 16_000_000;

/// Of what is encoded anew: features lose nothing that counts.
const QUALITY: u8 = 92;

/// What is left of each side when an image is still too long.
const STEP: f64 = 0.8;

/// An image that a server takes: as it is, or else upright, smaller and as JPEG. One that cannot be decoded stays as it is, so
/// that the server says what is wrong with it.
pub(crate) fn fitting(image: Vec<u8>) -> Vec<u8> {
    if image.len() <= MAX_IMAGE_BYTES && pixels(&image).is_none_or(|pixels| pixels <= MOST_PIXELS) {
        return image;
    }
    shrunk(&image).unwrap_or(image)
}

/// Width and height of an image as its camera stood: the file of a phone's upright photo may lie on its side, and say so.
///
/// # Errors
/// What is wrong with an image that cannot be read.
pub(crate) fn upright_size_px(image: impl BufRead + Seek) -> ImageResult<(u32, u32)> {
    let mut decoder = ImageReader::new(image).with_guessed_format()?.into_decoder()?;
    let (width, height) = decoder.dimensions();
    Ok(match decoder.orientation()? {
        Orientation::NoTransforms
        | Orientation::Rotate180
        | Orientation::FlipHorizontal
        | Orientation::FlipVertical => (width, height),
        Orientation::Rotate90
        | Orientation::Rotate270
        | Orientation::Rotate90FlipH
        | Orientation::Rotate270FlipH => (height, width),
    })
}

fn pixels(image: &[u8]) -> Option<u64> {
    let (width, height) =
        ImageReader::new(Cursor::new(image)).with_guessed_format().ok()?.into_dimensions().ok()?;
    Some(u64::from(width) * u64::from(height))
}

fn shrunk(image: &[u8]) -> Option<Vec<u8>> {
    let mut decoder = ImageReader::new(Cursor::new(image)).with_guessed_format().ok()?.into_decoder().ok()?;
    let orientation = decoder.orientation().ok()?;
    let mut decoded = DynamicImage::from_decoder(decoder).ok()?;
    // What is encoded has no EXIF any more.
    decoded.apply_orientation(orientation);
    let all = f64::from(decoded.width()) * f64::from(decoded.height());
    let mut scale = (MOST_PIXELS as f64 / all).sqrt().min(1.0);
    loop {
        let side = |side: u32| (f64::from(side) * scale).floor().max(1.0) as u32;
        let smaller = if scale < 1.0 {
            decoded.resize_exact(side(decoded.width()), side(decoded.height()), FilterType::Triangle)
        } else {
            decoded.clone()
        };
        let mut encoded = Vec::new();
        // JPEG has no transparency.
        let plain = DynamicImage::ImageRgb8(smaller.to_rgb8());
        plain.write_with_encoder(JpegEncoder::new_with_quality(&mut encoded, QUALITY)).ok()?;
        if encoded.len() <= MAX_IMAGE_BYTES {
            return Some(encoded);
        }
        scale *= STEP;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise, of which no encoder makes little.
    fn noise(width: u32, height: u32) -> DynamicImage {
        let mut state = 1_u32;
        let mut image = image::RgbImage::new(width, height);
        for pixel in image.pixels_mut() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            pixel.0 = [(state >> 8) as u8, (state >> 16) as u8, (state >> 24) as u8];
        }
        DynamicImage::ImageRgb8(image)
    }

    #[test]
    fn sizes_are_those_of_cameras_as_they_stood() {
        let mut plain = Vec::new();
        noise(30, 20).write_with_encoder(JpegEncoder::new(&mut plain)).unwrap();
        assert_eq!(upright_size_px(Cursor::new(&plain)).unwrap(), (30, 20));
        for (orientation, size_px) in [(1, (30, 20)), (3, (30, 20)), (6, (20, 30)), (8, (20, 30))] {
            let turned = turned(&plain, orientation);
            assert_eq!(upright_size_px(Cursor::new(&turned)).unwrap(), size_px, "{orientation}");
        }
        assert!(upright_size_px(Cursor::new(b"no image")).is_err());
    }

    /// A JPEG that says how its camera stood: EXIF of one entry, after the two bytes that it begins with.
    fn turned(jpeg: &[u8], orientation: u8) -> Vec<u8> {
        let entry = [b"\x01\x12\0\x03\0\0\0\x01\0", &[orientation][..], b"\0\0"].concat();
        let exif = [b"Exif\0\0MM\0*\0\0\0\x08\0\x01", &entry[..], b"\0\0\0\0"].concat();
        let length = (exif.len() as u16 + 2).to_be_bytes();
        [&jpeg[..2], b"\xff\xe1", &length, &exif, &jpeg[2..]].concat()
    }

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn what_a_server_takes_stays_as_it_is() {
        let small = png(&noise(64, 48));
        assert_eq!(fitting(small.clone()), small);
        let no_image = vec![7; MAX_IMAGE_BYTES + 1];
        assert_eq!(fitting(no_image.clone()), no_image);
    }

    #[test]
    fn what_is_too_large_is_made_smaller_in_its_proportions() {
        let many_pixels = DynamicImage::ImageLuma8(image::GrayImage::new(6000, 4000));
        for (image, proportion) in [(png(&many_pixels), 1.5), (png(&noise(1600, 1200)), 4.0 / 3.0)] {
            let fits = fitting(image);
            assert!(fits.len() <= MAX_IMAGE_BYTES && pixels(&fits).unwrap() <= MOST_PIXELS);
            let (width, height) = ImageReader::new(Cursor::new(&fits))
                .with_guessed_format()
                .unwrap()
                .into_dimensions()
                .unwrap();
            assert!((f64::from(width) / f64::from(height) - proportion).abs() < 0.01, "{width} x {height}");
        }
    }
}
