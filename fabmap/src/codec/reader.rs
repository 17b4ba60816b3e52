//! From bytes to values.

use super::error::DecodeError;

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
