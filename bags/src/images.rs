//! Messages with images: whether they can be used, and the image as a file.

use std::io::Cursor;

use crate::bytes::Encoding;
use crate::error::Problem;
use crate::messages::{CompressedImage, Image, Kind, reader};
use crate::pixels::Pixels;

/// What is known of an image before it is used.
pub(crate) struct Looked {
    pub(crate) stamp_ns: i64,
    pub(crate) frame_id: String,
    /// `jpeg`, `png`, or the encoding of raw pixels.
    pub(crate) form: String,
    /// Width and height, as far as the message says them.
    pub(crate) size_px: Option<(u32, u32)>,
}

/// Looks at a message of kind `Image` or `CompressedImage`, without decoding what it shows.
pub(crate) fn look(kind: Kind, encoding: &Encoding, data: &[u8]) -> Result<Looked, Problem> {
    let mut reader = reader(encoding, data)?;
    if kind == Kind::Image {
        let image = Image::read(&mut reader)?;
        Pixels::of(&image)?;
        let size_px = Some((image.width_px, image.height_px));
        return Ok(Looked {
            stamp_ns: image.header.stamp_ns,
            frame_id: image.header.frame_id.to_owned(),
            form: image.encoding.to_owned(),
            size_px,
        });
    }
    let image = CompressedImage::read(&mut reader)?;
    Ok(Looked {
        stamp_ns: image.header.stamp_ns,
        frame_id: image.header.frame_id.to_owned(),
        form: form(&image)?.to_owned(),
        size_px: None,
    })
}

/// The image as a JPEG or PNG: as it is, or made of raw pixels.
pub(crate) fn file(kind: Kind, encoding: &Encoding, data: &[u8]) -> Result<Vec<u8>, Problem> {
    let mut reader = reader(encoding, data)?;
    if kind == Kind::Image {
        return Pixels::of(&Image::read(&mut reader)?)?.to_png();
    }
    let image = CompressedImage::read(&mut reader)?;
    form(&image)?;
    Ok(image.data.to_vec())
}

/// Width and height of an image, by the head of its file.
pub(crate) fn size_px(kind: Kind, encoding: &Encoding, data: &[u8]) -> Option<(u32, u32)> {
    if kind != Kind::CompressedImage {
        return None;
    }
    let image = CompressedImage::read(&mut reader(encoding, data).ok()?).ok()?;
    let file = image::ImageReader::new(Cursor::new(image.data)).with_guessed_format().ok()?;
    file.into_dimensions().ok()
}

/// By the first bytes: what `format` says differs from driver to driver.
fn form(image: &CompressedImage<'_>) -> Result<&'static str, Problem> {
    match image.data {
        [0xff, 0xd8, 0xff, ..] => Ok("jpeg"),
        [0x89, b'P', b'N', b'G', ..] if !image.format.contains("16UC") => Ok("png"),
        _ => Err(Problem::Format(image.format.to_owned())),
    }
}
