//! From untrusted bytes to a grey image, and back to a thumbnail.
//!
//! Nothing is believed before it is checked: the format comes from the magic bytes alone, the size
//! from the header, and the pixels are decoded only once both are within limits.

use std::borrow::Cow;
use std::fmt;
use std::io::{Cursor, ErrorKind};

use ::image::codecs::{jpeg::JpegDecoder, jpeg::JpegEncoder, png::PngDecoder};
use ::image::{DynamicImage, ExtendedColorType, ImageDecoder, Limits};

use crate::mat;

/// Largest encoded image that is looked at, in bytes (4 MiB).
pub const MAX_ENCODED_BYTES: usize = 4 * 1024 * 1024;

/// Largest image that is decoded, in pixels (16 megapixels).
pub const MAX_PIXELS: u64 = 16_000_000;

/// Shortest side in which features can be looked for, in pixels.
pub const MIN_SIDE_PX: u32 = 16;

/// Longest side of an image that is decoded, in pixels: what a JPEG can say, so that a thumbnail can be made
/// of it.
pub const MAX_SIDE_PX: u32 = 65_535;

/// Most that a decoder may allocate, in bytes: the largest image as 16-bit RGBA, and an eighth more
/// for rows, tables and colour profiles.
const MAX_DECODER_BYTES: u64 = MAX_PIXELS * 8 + MAX_PIXELS;

/// Decodes a JPEG or PNG into grey levels.
///
/// Colour becomes luma as in Rec. 601, in integers: `(299 R + 587 G + 114 B + 500) / 1000`, rounded
/// down. Sixteen bits a channel are rounded to eight. Alpha is ignored: the colour under it counts.
/// An EXIF orientation is ignored too: rows stay as the camera delivered them, so that pixel
/// coordinates agree with the camera's calibration.
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
    /// proportion. An image that is no wider than that is lent as it is: enlarging adds no detail.
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
    fn from_decoder(error: ::image::ImageError) -> Self {
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

/// The height, at least 1, that keeps the proportions of `from_width` x `from_height` at `width`,
/// rounded; none if a width is zero or the height does not fit.
pub(crate) fn scaled_height(from_width: u32, from_height: u32, width: u32) -> Option<u32> {
    let doubled = 2 * u64::from(from_height) * u64::from(width) + u64::from(from_width);
    let rounded = doubled.checked_div(2 * u64::from(from_width))?.max(1);
    if width == 0 { None } else { u32::try_from(rounded).ok() }
}

#[derive(Clone, Copy, Debug)]
enum Format {
    Jpeg,
    Png,
}

impl Format {
    fn of(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"\xff\xd8\xff") {
            Some(Format::Jpeg)
        } else if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            Some(Format::Png)
        } else {
            None
        }
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
    let (width, height) = decoder.dimensions();
    decoder.set_limits(decoder_limits()).map_err(ImageError::from_decoder)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(ImageError::from_decoder)?;
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

/// Refuses what the decoder would misread: codings it does not know, and files without an end
/// marker, which it completes in grey.
fn check_jpeg_segments(bytes: &[u8]) -> Result<(), ImageError> {
    let unsupported = |reason: &str| ImageError::Unsupported { format: "JPEG", reason: reason.to_owned() };
    for segment in JpegSegments(bytes) {
        match segment {
            (JpegSegments::END_OF_IMAGE, _) => return Ok(()),
            // Frame headers: baseline, extended, progressive; their first byte is the precision.
            (0xc0..=0xc2, [bits, ..]) if *bits != 8 => {
                return Err(unsupported(&format!("{bits} bits a channel")));
            }
            (0xc3, _) => return Err(unsupported("lossless coding")),
            (0xc5..=0xc7, _) => return Err(unsupported("hierarchical coding")),
            (0xc9..=0xcb | 0xcd..=0xcf, _) => return Err(unsupported("arithmetic coding")),
            _ => {}
        }
    }
    Err(ImageError::Truncated)
}

/// The marker segments of a JPEG, each as marker code and content (ITU-T T.81, annex B).
///
/// They are jumped over by their length, so that the end marker of a thumbnail inside the metadata
/// is not taken for the picture's own. Compressed data is passed over too: it holds no marker but
/// restarts.
struct JpegSegments<'a>(&'a [u8]);

impl JpegSegments<'_> {
    const END_OF_IMAGE: u8 = 0xd9;
}

impl<'a> Iterator for JpegSegments<'a> {
    type Item = (u8, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            self.0 = match self.0 {
                [] => return None,
                // A stuffed zero, and the markers that stand alone: TEM, RST0 to RST7, SOI.
                [0xff, 0x00 | 0x01 | 0xd0..=0xd8, rest @ ..] => rest,
                [0xff, Self::END_OF_IMAGE, rest @ ..] => {
                    self.0 = rest;
                    return Some((Self::END_OF_IMAGE, &[]));
                }
                // Two 0xff: the first is a fill byte. Else a segment; its length counts itself.
                [0xff, code, high, low, rest @ ..] if *code != 0xff => {
                    let length = usize::from(u16::from_be_bytes([*high, *low])).saturating_sub(2);
                    let (content, rest) = rest.split_at_checked(length).unwrap_or((rest, &[]));
                    self.0 = rest;
                    return Some((*code, content));
                }
                [_, rest @ ..] => rest,
            };
        }
    }
}

/// Names what people and robots send by mistake.
fn describe_unknown(bytes: &[u8]) -> String {
    let known: [(&[u8], &str); 16] = [
        (b"GIF8", "GIF"),
        (b"BM", "BMP"),
        (b"II*\0", "TIFF"),
        (b"MM\0*", "TIFF"),
        (b"P1\n", "PBM"),
        (b"P2\n", "PGM"),
        (b"P3\n", "PPM"),
        (b"P4\n", "PBM"),
        (b"P5\n", "PGM"),
        (b"P6\n", "PPM"),
        (b"\0\0\0\x0cjP", "JPEG 2000"),
        (b"%PDF", "PDF"),
        (b"<", "a text page (HTML, SVG or XML)"),
        (b"data:image/", "a data URL; send the bytes it encodes"),
        (b"/9j/", "JPEG in base64 text; send the bytes it encodes"),
        (b"iVBORw0KGgo", "PNG in base64 text; send the bytes it encodes"),
    ];
    if let Some((_, name)) = known.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return (*name).to_owned();
    }
    match bytes {
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => "WebP".to_owned(),
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => "HEIF, AVIF or video".to_owned(),
        _ if bytes.iter().all(|&byte| byte == 0) => "all zero bytes".to_owned(),
        _ => {
            let start: Vec<String> = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            format!("something unknown that starts with the bytes {}", start.join(" "))
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
