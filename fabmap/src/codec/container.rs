//! A file: magic, version, length, payload, SHA-256.

use sha2::{Digest, Sha256};

use super::error::DecodeError;
use super::reader::Reader;
use super::writer::Writer;

/// A file format: its first eight bytes, its name for people, and the newest version there is.
#[derive(Clone, Copy, Debug)]
pub struct Container {
    /// First eight bytes of the file.
    pub magic: [u8; 8],
    /// What a person calls such a file.
    pub name: &'static str,
    /// Version that [`Container::seal`] writes and the newest that [`Container::open`] reads.
    pub version: u32,
}

const HEADER_BYTES: usize = 8 + 4 + 8;
const HASH_BYTES: usize = 32;

impl Container {
    /// Wraps `payload`: magic, version, length, payload, SHA-256 of all that goes before.
    #[must_use]
    pub fn seal(&self, payload: &[u8]) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.raw(&self.magic);
        writer.u32(self.version);
        writer.u64(payload.len() as u64);
        writer.raw(payload);
        let hash = Sha256::digest(writer.as_bytes());
        writer.raw(&hash);
        writer.into_bytes()
    }

    /// Checks the wrapping and returns version and payload.
    ///
    /// # Errors
    /// Any of [`DecodeError`], the most telling first: a foreign file is `Magic`, a newer one
    /// `Version`, a cut one `Truncated`, a damaged one `Checksum`.
    pub fn open<'a>(&self, sealed: &'a [u8]) -> Result<(u32, &'a [u8]), DecodeError> {
        let mut reader = Reader::new(sealed);
        if reader.raw(8).ok() != Some(self.magic.as_slice()) {
            return Err(DecodeError::Magic { expected: self.name });
        }
        let version = reader.u32()?;
        if version == 0 || version > self.version {
            return Err(DecodeError::Version { found: version, newest: self.version });
        }
        let length = usize::try_from(reader.u64()?).map_err(|_| DecodeError::invalid("length"))?;
        let payload = reader.raw(length)?;
        let hash = reader.raw(HASH_BYTES)?;
        reader.end()?;
        let content = &sealed[..HEADER_BYTES + length];
        if Sha256::digest(content).as_slice() != hash {
            return Err(DecodeError::Checksum);
        }
        Ok((version, payload))
    }
}
