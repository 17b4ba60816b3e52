//! Why an image cannot be read or made.

use std::io::ErrorKind;

use super::limits::{MAX_ENCODED_BYTES, MAX_PIXELS, MAX_SIDE_PX, MIN_SIDE_PX};

/// Why an image cannot be read or made. The messages address the person who sent it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// No bytes at all.
    #[error("the image is empty; send the bytes of a JPEG or PNG file")]
    Empty,
    /// More encoded bytes than [`MAX_ENCODED_BYTES`].
    #[error(
        "the image has {bytes} bytes, more than the {max} allowed; \
         shrink it or lower its JPEG quality before sending",
        max = MAX_ENCODED_BYTES
    )]
    TooManyBytes {
        /// Bytes given.
        bytes: usize,
    },
    /// The magic bytes are neither JPEG's nor PNG's.
    #[error("the image is neither JPEG nor PNG but {found}; convert it to JPEG or PNG")]
    UnknownFormat {
        /// What the bytes look like, as a noun phrase.
        found: String,
    },
    /// A JPEG or PNG of a kind that is not decoded.
    #[error(
        "this kind of {format} is not supported ({reason}); \
         save it as 8-bit baseline or progressive JPEG, or as PNG"
    )]
    Unsupported {
        /// `JPEG` or `PNG`.
        format: &'static str,
        /// What the decoder stumbled over.
        reason: String,
    },
    /// More pixels than [`MAX_PIXELS`].
    #[error(
        "the image is {width} x {height} ({megapixels:.1} megapixels), more than the {max} megapixels allowed; \
         shrink it before sending",
        megapixels = megapixels(*width, *height),
        max = MAX_PIXELS / 1_000_000
    )]
    TooLarge {
        /// Pixels per row, as the header claims.
        width: u32,
        /// Rows, as the header claims.
        height: u32,
    },
    /// A side shorter than [`MIN_SIDE_PX`].
    #[error(
        "the image is {width} x {height}, but both sides must have at least {min} pixels; \
         send the camera's full image, not a thumbnail",
        min = MIN_SIDE_PX
    )]
    TooSmall {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A side longer than [`MAX_SIDE_PX`].
    #[error(
        "the image is {width} x {height}, but no side may have more than {max} pixels; \
         shrink it, or cut it into several",
        max = MAX_SIDE_PX
    )]
    TooLong {
        /// Pixels per row, as the header claims.
        width: u32,
        /// Rows, as the header claims.
        height: u32,
    },
    /// Decoding would take more memory than any image within the limits needs.
    #[error(
        "decoding the image would take more memory than allowed; \
         remove its metadata and colour profile, or save it anew"
    )]
    TooMuchMemory,
    /// The bytes end before the image does.
    #[error("the image is cut off before its end; send the whole file again")]
    Truncated,
    /// The bytes contradict themselves.
    #[error("the image is damaged ({reason}); capture or save it again")]
    Damaged {
        /// What the decoder stumbled over.
        reason: String,
    },
    /// A side is zero.
    #[error("an image of {width} x {height} has no pixels; both sides must be at least 1")]
    NoPixels {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The number of pixels is not width times height.
    #[error("{pixels} pixels do not fill {width} x {height}; give one byte per pixel, row by row, unpadded")]
    PixelCount {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Pixels given.
        pixels: usize,
    },
    /// OpenCV could not shrink the image.
    #[error("the image could not be shrunk ({reason}); try again when the machine has memory to spare")]
    Resize {
        /// OpenCV's words.
        reason: String,
    },
    /// The JPEG quality is not within 1 to 100.
    #[error("JPEG quality {quality} is out of range; use 1 to 100")]
    Quality {
        /// The quality asked for.
        quality: u8,
    },
    /// The image cannot be written as JPEG.
    #[error("the image cannot be written as JPEG ({reason}); shrink it first")]
    Encode {
        /// What the encoder stumbled over.
        reason: String,
    },
}

impl ImageError {
    pub(super) fn from_decoder(error: ::image::ImageError) -> Self {
        use ::image::ImageError as Decoder;
        match error {
            Decoder::IoError(io) if io.kind() == ErrorKind::UnexpectedEof => ImageError::Truncated,
            Decoder::IoError(io) => ImageError::Damaged { reason: io.to_string() },
            Decoder::Decoding(decoding) => ImageError::Damaged { reason: innermost_cause(&decoding) },
            Decoder::Unsupported(unsupported) => ImageError::Unsupported {
                format: match unsupported.format_hint() {
                    ::image::error::ImageFormatHint::Exact(::image::ImageFormat::Png) => "PNG",
                    _ => "JPEG",
                },
                reason: unsupported.to_string(),
            },
            Decoder::Limits(_) => ImageError::TooMuchMemory,
            Decoder::Parameter(parameter) => ImageError::Damaged { reason: parameter.to_string() },
            Decoder::Encoding(encoding) => ImageError::Encode { reason: encoding.to_string() },
        }
    }
}

/// The cause that names the problem itself: the library wraps it in "format error decoding …".
fn innermost_cause(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string().trim_matches('"').to_owned()
}

fn megapixels(width: u32, height: u32) -> f64 {
    f64::from(width) * f64::from(height) / 1e6
}
