//! From untrusted bytes to a grey image, and back to a thumbnail.
//!
//! Nothing is believed before it is checked: the format comes from the magic bytes alone, the size
//! from the header, and the pixels are decoded only once both are within limits.

mod error;
mod format;
mod grey_image;
mod jpeg_segments;
mod limits;

use std::io::Cursor;

use ::image::codecs::{jpeg::JpegDecoder, png::PngDecoder};
use ::image::{DynamicImage, ImageDecoder, Limits};

use format::{Format, describe_unknown};
use jpeg_segments::check_jpeg_segments;
use limits::MAX_DECODER_BYTES;

pub use error::ImageError;
pub use grey_image::GreyImage;
pub use limits::{MAX_ENCODED_BYTES, MAX_PIXELS, MAX_SIDE_PX, MIN_SIDE_PX};

/// Decodes a JPEG or PNG into grey levels.
///
/// Colour becomes luma as in Rec. 601, in integers: `(299 R + 587 G + 114 B + 500) / 1000`, rounded
/// down. Sixteen bits a channel are rounded to eight. Alpha is ignored: the colour under it counts.
/// An EXIF orientation is honoured: a phone's upright photo lies on its side in the file. A camera
/// is declared, and calibrated, for images as they come out of here.
///
/// A JPEG that stops before its end marker is refused, although most decoders would fill the rest
/// with grey: half a view would be learnt as a place of its own. Damage inside a JPEG's
/// compressed stream that leaves the markers whole cannot always be told from picture content
/// (JPEG carries no checksum) and then decodes.
///
/// # Errors
/// [`ImageError`], with a variant of its own for each way in which the bytes can be wrong.
pub fn decode(bytes: &[u8]) -> Result<GreyImage, ImageError> {
    if bytes.is_empty() {
        return Err(ImageError::Empty);
    }
    if bytes.len() > MAX_ENCODED_BYTES {
        return Err(ImageError::TooManyBytes { bytes: bytes.len() });
    }
    match Format::of(bytes) {
        Some(Format::Jpeg) => {
            check_jpeg_segments(bytes)?;
            let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(ImageError::from_decoder)?;
            check_size(&decoder)?;
            decode_pixels(decoder)
        }
        Some(Format::Png) => {
            let decoder = PngDecoder::with_limits(Cursor::new(bytes), decoder_limits())
                .map_err(ImageError::from_decoder)?;
            check_size(&decoder)?;
            decode_pixels(decoder)
        }
        None => Err(ImageError::UnknownFormat { found: describe_unknown(bytes) }),
    }
}

fn check_size(decoder: &impl ImageDecoder) -> Result<(), ImageError> {
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(ImageError::TooLarge { width, height });
    }
    if width.min(height) < MIN_SIDE_PX {
        return Err(ImageError::TooSmall { width, height });
    }
    if width.max(height) > MAX_SIDE_PX {
        return Err(ImageError::TooLong { width, height });
    }
    Ok(())
}

fn decoder_limits() -> Limits {
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    limits
}

fn decode_pixels(mut decoder: impl ImageDecoder) -> Result<GreyImage, ImageError> {
    decoder.set_limits(decoder_limits()).map_err(ImageError::from_decoder)?;
    let orientation = decoder.orientation().map_err(ImageError::from_decoder)?;
    let mut decoded = DynamicImage::from_decoder(decoder).map_err(ImageError::from_decoder)?;
    decoded.apply_orientation(orientation);
    let (width, height) = (decoded.width(), decoded.height());
    let pixels = match decoded {
        DynamicImage::ImageLuma8(grey) => grey.into_raw(),
        DynamicImage::ImageLumaA8(grey) => grey.pixels().map(|pixel| pixel.0[0]).collect(),
        DynamicImage::ImageRgb8(colour) => colour.pixels().map(|pixel| luma(pixel.0)).collect(),
        DynamicImage::ImageRgba8(colour) => {
            colour.pixels().map(|&::image::Rgba([r, g, b, _])| luma([r, g, b])).collect()
        }
        DynamicImage::ImageLuma16(grey) => grey.pixels().map(|pixel| to_byte(pixel.0[0])).collect(),
        DynamicImage::ImageLumaA16(grey) => grey.pixels().map(|pixel| to_byte(pixel.0[0])).collect(),
        DynamicImage::ImageRgb16(colour) => colour.pixels().map(|pixel| luma(pixel.0.map(to_byte))).collect(),
        DynamicImage::ImageRgba16(colour) => {
            colour.pixels().map(|&::image::Rgba([r, g, b, _])| luma([r, g, b].map(to_byte))).collect()
        }
        // Floating-point pixels, which neither format has, and kinds the library may add.
        other => other.to_rgb8().pixels().map(|pixel| luma(pixel.0)).collect(),
    };
    GreyImage::new(width, height, pixels)
}

/// Rec. 601 luma; the weights add up to 1000, so nothing saturates.
fn luma([red, green, blue]: [u8; 3]) -> u8 {
    let weighted = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
    u8::try_from((weighted + 500) / 1000).unwrap_or(u8::MAX)
}

/// 0..=65535 to 0..=255, rounded.
fn to_byte(sample: u16) -> u8 {
    u8::try_from((u32::from(sample) + 128) / 257).unwrap_or(u8::MAX)
}
