//! What kind of file bytes are, by their first ones.

/// A format that is decoded.
#[derive(Clone, Copy, Debug)]
pub(super) enum Format {
    Jpeg,
    Png,
}

impl Format {
    pub(super) fn of(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"\xff\xd8\xff") {
            Some(Format::Jpeg)
        } else if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            Some(Format::Png)
        } else {
            None
        }
    }
}

/// Bytes at the beginning of a file by which text is told.
const TEXT_BYTES: usize = 512;

/// Whether this is ASCII text as far as it is looked at.
fn is_text(bytes: &[u8]) -> bool {
    bytes.iter().take(TEXT_BYTES).all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace())
}

/// Names what people and robots send by mistake.
pub(super) fn describe_unknown(bytes: &[u8]) -> String {
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
        _ if is_text(bytes) => "a text file".to_owned(),
        _ => {
            let start: Vec<String> = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            format!("something unknown that starts with the bytes {}", start.join(" "))
        }
    }
}
