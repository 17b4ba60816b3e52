//! Grey levels in rows.

use std::borrow::Cow;
use std::fmt;

use ::image::ExtendedColorType;
use ::image::codecs::jpeg::JpegEncoder;

use super::error::ImageError;
use super::limits::MAX_PIXELS;
use crate::mat;

/// A grey image: `height` rows of `width` bytes, 0 black to 255 white, top row first.
///
/// Pixel coordinates are x to the right and y down; (0, 0) is the *centre* of the top left pixel.
#[derive(Clone, PartialEq, Eq)]
pub struct GreyImage {
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl GreyImage {
    /// Takes `pixels` as `height` rows of `width` bytes.
    ///
    /// # Errors
    /// [`ImageError::NoPixels`] if a side is zero, [`ImageError::TooLarge`] above [`MAX_PIXELS`],
    /// [`ImageError::PixelCount`] if `pixels` has another length.
    pub fn new(width: u32, height: u32, pixels: Vec<u8>) -> Result<Self, ImageError> {
        let expected = u64::from(width) * u64::from(height);
        if expected == 0 {
            return Err(ImageError::NoPixels { width, height });
        }
        if expected > MAX_PIXELS {
            return Err(ImageError::TooLarge { width, height });
        }
        if u64::try_from(pixels.len()) != Ok(expected) {
            return Err(ImageError::PixelCount { width, height, pixels: pixels.len() });
        }
        Ok(Self { width, height, pixels })
    }

    /// Pixels per row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Number of rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, row by row.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The image shrunk to `width` pixels by area averaging, its height to the nearest pixel in
    /// proportion. An image that is not wider than that is borrowed as it is: enlarging adds no
    /// detail.
    ///
    /// # Errors
    /// [`ImageError::NoPixels`] if `width` is zero; [`ImageError::Resize`] if OpenCV fails, out of
    /// memory for example.
    pub fn resize_to_width(&self, width: u32) -> Result<Cow<'_, GreyImage>, ImageError> {
        if width >= self.width {
            return Ok(Cow::Borrowed(self));
        }
        let height = scaled_height(self.width, self.height, width)
            .ok_or(ImageError::NoPixels { width, height: self.height })?;
        let pixels = mat::borrow_grey(self.width, self.height, &self.pixels)
            .and_then(|source| mat::shrink(&source, width, height))
            .map_err(|error| ImageError::Resize { reason: error.message })?;
        GreyImage::new(width, height, pixels).map(Cow::Owned)
    }

    /// The image as a baseline grey JPEG; `quality` from 1 (small) to 100 (faithful).
    ///
    /// # Errors
    /// [`ImageError::Quality`] if `quality` is out of range, [`ImageError::Encode`] if a side is
    /// longer than JPEG can say (65,535 pixels).
    pub fn encode_jpeg(&self, quality: u8) -> Result<Vec<u8>, ImageError> {
        if !(1..=100).contains(&quality) {
            return Err(ImageError::Quality { quality });
        }
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, quality)
            .encode(&self.pixels, self.width, self.height, ExtendedColorType::L8)
            .map_err(|error| ImageError::Encode { reason: error.to_string() })?;
        Ok(jpeg)
    }
}

impl fmt::Debug for GreyImage {
    /// Names the size alone: millions of pixels help nobody in a log.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { width, height, pixels: _ } = self;
        formatter
            .debug_struct("GreyImage")
            .field("width", width)
            .field("height", height)
            .finish_non_exhaustive()
    }
}

/// The height, at least 1, that keeps the proportions of `from_width` x `from_height` at `width`,
/// rounded; none if a width is zero or the height does not fit.
fn scaled_height(from_width: u32, from_height: u32, width: u32) -> Option<u32> {
    let doubled = 2 * u64::from(from_height) * u64::from(width) + u64::from(from_width);
    let rounded = doubled.checked_div(2 * u64::from(from_width))?.max(1);
    if width == 0 { None } else { u32::try_from(rounded).ok() }
}
