//! What a camera hands over.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

/// An image of 8-bit grey values, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GreyImage {
    width_px: u32,
    height_px: u32,
    pixels: Vec<u8>,
}

/// Why an image could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The pixels do not make that many rows and columns.
    #[error("{pixels} pixels are not {width_px} columns of {height_px} rows; both must be above 0")]
    Size {
        /// Number of pixels.
        pixels: usize,
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// The file's format does not take it.
    #[error("the image cannot be encoded: {0}; choose a smaller camera")]
    Encoding(#[from] image::ImageError),
}

impl GreyImage {
    /// # Errors
    /// [`ImageError::Size`] unless there are `width_px` times `height_px` pixels, and some.
    pub fn new(width_px: u32, height_px: u32, pixels: Vec<u8>) -> Result<Self, ImageError> {
        if pixels.is_empty() || width_px as usize * height_px as usize != pixels.len() {
            return Err(ImageError::Size { pixels: pixels.len(), width_px, height_px });
        }
        Ok(Self { width_px, height_px, pixels })
    }

    /// Columns.
    #[must_use]
    pub fn width_px(&self) -> u32 {
        self.width_px
    }

    /// Rows.
    #[must_use]
    pub fn height_px(&self) -> u32 {
        self.height_px
    }

    /// Grey values, row by row from the top left.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The grey value at a column and a row.
    ///
    /// # Panics
    /// If they are outside of the image.
    #[must_use]
    pub fn at(&self, column: u32, row: u32) -> u8 {
        assert!(column < self.width_px, "column {column} of {}", self.width_px);
        self.pixels[row as usize * self.width_px as usize + column as usize]
    }

    /// The bytes of a PNG file: nothing is lost.
    ///
    /// # Errors
    /// [`ImageError::Encoding`] if the format does not take an image of that size.
    pub fn to_png(&self) -> Result<Vec<u8>, ImageError> {
        let mut bytes = Vec::new();
        let encoder = PngEncoder::new(Cursor::new(&mut bytes));
        encoder.write_image(&self.pixels, self.width_px, self.height_px, ExtendedColorType::L8)?;
        Ok(bytes)
    }

    /// The bytes of a JPEG file of quality 90, as a robot would send it.
    ///
    /// # Errors
    /// [`ImageError::Encoding`] if the format does not take an image of that size.
    pub fn to_jpeg(&self) -> Result<Vec<u8>, ImageError> {
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(Cursor::new(&mut bytes), 90);
        encoder.write_image(&self.pixels, self.width_px, self.height_px, ExtendedColorType::L8)?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_hold_the_image() {
        let pixels: Vec<u8> = (0..24 * 16).map(|i| (i % 24 * 10) as u8).collect();
        let image = GreyImage::new(24, 16, pixels).unwrap();
        let png = image::load_from_memory(&image.to_png().unwrap()).unwrap().to_luma8();
        assert_eq!((png.width(), png.height(), png.as_raw().as_slice()), (24, 16, image.pixels()));
        let jpeg = image::load_from_memory(&image.to_jpeg().unwrap()).unwrap().to_luma8();
        let off = jpeg.as_raw().iter().zip(image.pixels()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!((1..12).contains(&off), "JPEG is off by {off}");
        assert!(matches!(GreyImage::new(3, 3, vec![0; 8]), Err(ImageError::Size { pixels: 8, .. })));
    }
}
