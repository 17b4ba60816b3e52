//! The byte formats' alphabet: little-endian numbers, variable-length integers, and a sealed
//! container with magic, version and SHA-256.
//!
//! Every format built on it is a pure function between bytes and a value, kept beside that value.

use sha2::{Digest, Sha256};

/// Why bytes are not the value they should be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The bytes end early.
    #[error("the data ends early: {needed} more bytes were expected; it was cut short, so fetch it again")]
    Truncated {
        /// Bytes missing.
        needed: usize,
    },
    /// The bytes do not begin as this format does.
    #[error("this is not a {expected} file; check which file was given")]
    Magic {
        /// What was expected, in words.
        expected: &'static str,
    },
    /// Written by a newer version of Waypost.
    #[error("written in format version {found}, this program reads up to {newest}; update Waypost")]
    Version {
        /// Version in the data.
        found: u32,
        /// Newest version that can be read.
        newest: u32,
    },
    /// The checksum does not agree with the content.
    #[error("the checksum does not match the content; the data is damaged, so fetch it again")]
    Checksum,
    /// A value that no writer produces.
    #[error("invalid content: {what}; the data is damaged or was not written by Waypost")]
    Invalid {
        /// What is wrong.
        what: String,
    },
    /// Content goes on after the value's end.
    #[error("{bytes} bytes follow the end of the content; the data is damaged")]
    Trailing {
        /// Bytes left over.
        bytes: usize,
    },
}

impl DecodeError {
    /// A [`DecodeError::Invalid`] that says `what`.
    pub fn invalid(what: impl std::fmt::Display) -> Self {
        Self::Invalid { what: what.to_string() }
    }
}

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
        let hash = Sha256::digest(&writer.bytes);
        writer.raw(&hash);
        writer.bytes
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

/// Appends values to bytes.
#[derive(Clone, Debug, Default)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// What was written.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Bytes as they are.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// One byte.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// Four bytes.
    pub fn u32(&mut self, value: u32) {
        self.raw(&value.to_le_bytes());
    }

    /// Eight bytes.
    pub fn u64(&mut self, value: u64) {
        self.raw(&value.to_le_bytes());
    }

    /// Eight bytes, two's complement.
    pub fn i64(&mut self, value: i64) {
        self.raw(&value.to_le_bytes());
    }

    /// Eight bytes, IEEE 754; the bits are kept.
    pub fn f64(&mut self, value: f64) {
        self.raw(&value.to_le_bytes());
    }

    /// Seven bits a byte, least significant first: small numbers are short.
    pub fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push((value as u8) | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// Length, then the bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.varint(bytes.len() as u64);
        self.raw(bytes);
    }

    /// Length, then UTF-8.
    pub fn str(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }
}

/// Takes values off bytes; every read says how it failed.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Reads from the first byte of `bytes`.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// Bytes not yet read.
    #[must_use]
    pub fn remaining(&self) -> usize {
        self.rest.len()
    }

    /// Says that nothing may follow.
    ///
    /// # Errors
    /// [`DecodeError::Trailing`] if something does.
    pub fn end(&self) -> Result<(), DecodeError> {
        if self.rest.is_empty() { Ok(()) } else { Err(DecodeError::Trailing { bytes: self.rest.len() }) }
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// [`DecodeError::Truncated`] if there are fewer; this holds for every read below.
    pub fn raw(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        match self.rest.split_at_checked(count) {
            Some((taken, rest)) => {
                self.rest = rest;
                Ok(taken)
            }
            None => Err(DecodeError::Truncated { needed: count - self.rest.len() }),
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        match self.rest.split_first_chunk::<N>() {
            Some((taken, rest)) => {
                self.rest = rest;
                Ok(*taken)
            }
            None => Err(DecodeError::Truncated { needed: N - self.rest.len() }),
        }
    }

    /// One byte.
    ///
    /// # Errors
    /// See [`Reader::raw`].
    pub fn u8(&mut self) -> Result<u8, DecodeError> {
        Ok(u8::from_le_bytes(self.array()?))
    }

    /// Four bytes.
    ///
    /// # Errors
    /// See [`Reader::raw`].
    pub fn u32(&mut self) -> Result<u32, DecodeError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// Eight bytes.
    ///
    /// # Errors
    /// See [`Reader::raw`].
    pub fn u64(&mut self) -> Result<u64, DecodeError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    /// Eight bytes, two's complement.
    ///
    /// # Errors
    /// See [`Reader::raw`].
    pub fn i64(&mut self) -> Result<i64, DecodeError> {
        Ok(i64::from_le_bytes(self.array()?))
    }

    /// Eight bytes, IEEE 754; any bits, NaN too: the caller checks ranges.
    ///
    /// # Errors
    /// See [`Reader::raw`].
    pub fn f64(&mut self) -> Result<f64, DecodeError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    /// A variable-length integer of at most 64 bits.
    ///
    /// # Errors
    /// See [`Reader::raw`]; [`DecodeError::Invalid`] if it is longer.
    pub fn varint(&mut self) -> Result<u64, DecodeError> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.u8()?;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                break;
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(DecodeError::invalid("an integer of more than 64 bits"))
    }

    /// A variable-length integer that counts items of at least `item_bytes` bytes still to come;
    /// a count that the remaining bytes cannot hold is refused before memory is reserved for it.
    ///
    /// # Errors
    /// See [`Reader::varint`]; [`DecodeError::Truncated`] if the items cannot all be there.
    pub fn count(&mut self, item_bytes: usize) -> Result<usize, DecodeError> {
        let count = usize::try_from(self.varint()?).map_err(|_| DecodeError::invalid("a count"))?;
        let needed = count.checked_mul(item_bytes).ok_or_else(|| DecodeError::invalid("a count"))?;
        if needed > self.rest.len() {
            return Err(DecodeError::Truncated { needed: needed - self.rest.len() });
        }
        Ok(count)
    }

    /// A variable-length integer of at most 32 bits.
    ///
    /// # Errors
    /// See [`Reader::varint`].
    pub fn varint_u32(&mut self) -> Result<u32, DecodeError> {
        u32::try_from(self.varint()?).map_err(|_| DecodeError::invalid("an integer of more than 32 bits"))
    }

    /// Length, then bytes.
    ///
    /// # Errors
    /// See [`Reader::count`].
    pub fn bytes(&mut self) -> Result<&'a [u8], DecodeError> {
        let count = self.count(1)?;
        self.raw(count)
    }

    /// Length, then UTF-8.
    ///
    /// # Errors
    /// See [`Reader::count`]; [`DecodeError::Invalid`] if it is not UTF-8.
    pub fn str(&mut self) -> Result<&'a str, DecodeError> {
        std::str::from_utf8(self.bytes()?).map_err(|_| DecodeError::invalid("text that is not UTF-8"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FORMAT: Container = Container { magic: *b"WPTEST\r\n", name: "test", version: 3 };

    proptest! {
        #[test]
        fn what_is_written_is_read(a in any::<u64>(), b in any::<i64>(), c in any::<u64>(), text in ".*") {
            let mut writer = Writer::default();
            writer.varint(a);
            writer.i64(b);
            writer.f64(f64::from_bits(c));
            writer.str(&text);
            let bytes = writer.into_bytes();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(reader.varint(), Ok(a));
            prop_assert_eq!(reader.i64(), Ok(b));
            prop_assert_eq!(reader.f64().map(f64::to_bits), Ok(c));
            prop_assert_eq!(reader.str(), Ok(text.as_str()));
            prop_assert_eq!(reader.end(), Ok(()));
        }

        #[test]
        fn a_sealed_payload_opens_and_no_flipped_bit_passes(
            payload in proptest::collection::vec(any::<u8>(), 0..200), position in any::<prop::sample::Index>(), bit in 0..8u8,
        ) {
            let mut sealed = FORMAT.seal(&payload);
            prop_assert_eq!(FORMAT.open(&sealed), Ok((3, payload.as_slice())));
            let flipped = position.index(sealed.len());
            sealed[flipped] ^= 1 << bit;
            prop_assert!(FORMAT.open(&sealed).is_err());
        }

        #[test]
        fn any_cut_is_refused(payload in proptest::collection::vec(any::<u8>(), 0..50), cut in any::<prop::sample::Index>()) {
            let sealed = FORMAT.seal(&payload);
            let shorter = &sealed[..cut.index(sealed.len())];
            prop_assert!(FORMAT.open(shorter).is_err());
        }
    }

    #[test]
    fn each_damage_has_its_own_name() {
        let sealed = FORMAT.seal(b"payload");
        assert_eq!(FORMAT.open(b"GIF89a"), Err(DecodeError::Magic { expected: "test" }));
        let newer = Container { version: 9, ..FORMAT }.seal(b"payload");
        assert_eq!(FORMAT.open(&newer), Err(DecodeError::Version { found: 9, newest: 3 }));
        assert_eq!(FORMAT.open(&sealed[..sealed.len() - 1]), Err(DecodeError::Truncated { needed: 1 }));
        let mut longer = sealed.clone();
        longer.push(0);
        assert_eq!(FORMAT.open(&longer), Err(DecodeError::Trailing { bytes: 1 }));
    }

    #[test]
    fn a_count_that_cannot_be_there_reserves_nothing() {
        let mut writer = Writer::default();
        writer.varint(u64::MAX >> 8);
        let bytes = writer.into_bytes();
        assert!(matches!(
            Reader::new(&bytes).count(4),
            Err(DecodeError::Truncated { .. } | DecodeError::Invalid { .. })
        ));
    }
}
