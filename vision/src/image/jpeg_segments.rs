//! The parts of a JPEG, looked through before it is decoded.

use super::error::ImageError;

/// Refuses what the decoder would misread: codings it does not know, and files without an end
/// marker, which it completes in grey.
pub(super) fn check_jpeg_segments(bytes: &[u8]) -> Result<(), ImageError> {
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
