//! Bytes of a message as numbers, strings and sequences: ROS 2's CDR of either byte order, and ROS 1's.

/// Where the bytes of a message are not what its type says.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at byte {at_byte}: {flaw}")]
pub struct Malformed {
    /// From the start of the message.
    pub at_byte: usize,
    /// What is wrong there.
    pub flaw: Flaw,
}

/// What is wrong with bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Flaw {
    /// The message ends too early.
    #[error("{needed} bytes are needed and {left} are left")]
    Short {
        /// What a value takes.
        needed: usize,
        /// What there is.
        left: usize,
    },
    /// A length says more than there is.
    #[error("a length says {count} elements, and {left} bytes are left")]
    Length {
        /// As written.
        count: u32,
        /// What there is.
        left: usize,
    },
    /// A string is no text.
    #[error("a string is not UTF-8")]
    Text,
    /// CDR of another version.
    #[error("encapsulation {0:#06x} is not read; plain CDR of version 1 (0x0000 and 0x0001) is")]
    Encapsulation(u16),
}

/// How the messages of a topic are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// ROS 2: plain CDR of version 1, its byte order at its head.
    Cdr,
    /// ROS 1: little endian, without gaps.
    Ros1,
    /// Something else, by the name that the file gives it.
    Other(String),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Order {
    Little,
    Big,
}

/// Reads values one after another. Nothing is read past the end, and no length is believed that says more than is left.
pub(crate) struct Reader<'a> {
    data: &'a [u8],
    position: usize,
    /// Whether values are aligned, as in CDR, and from where.
    aligned_from: Option<usize>,
    order: Order,
}

impl<'a> Reader<'a> {
    /// Numbers without gaps, the lowest byte first.
    pub(crate) fn packed(data: &'a [u8]) -> Self {
        Self { data, position: 0, aligned_from: None, order: Order::Little }
    }

    /// CDR, behind its four bytes of encapsulation.
    pub(crate) fn cdr(data: &'a [u8]) -> Result<Self, Malformed> {
        let mut head = Self::packed(data);
        let [high, low, _, _] = head.array()?;
        let order = match u16::from_be_bytes([high, low]) {
            0 => Order::Big,
            1 => Order::Little,
            other => return Err(Malformed { at_byte: 0, flaw: Flaw::Encapsulation(other) }),
        };
        Ok(Self { data, position: head.position, aligned_from: Some(head.position), order })
    }

    pub(crate) fn is_ros1(&self) -> bool {
        self.aligned_from.is_none()
    }

    fn left(&self) -> usize {
        self.data.len() - self.position
    }

    pub(crate) fn is_at_end(&self) -> bool {
        self.left() == 0
    }

    fn flawed(&self, flaw: Flaw) -> Malformed {
        Malformed { at_byte: self.position, flaw }
    }

    pub(crate) fn take(&mut self, size: usize) -> Result<&'a [u8], Malformed> {
        let left = self.left();
        let taken = self.data.get(self.position..).and_then(|rest| rest.get(..size));
        let taken = taken.ok_or_else(|| self.flawed(Flaw::Short { needed: size, left }))?;
        self.position += size;
        Ok(taken)
    }

    fn array<const SIZE: usize>(&mut self) -> Result<[u8; SIZE], Malformed> {
        let mut array = [0; SIZE];
        array.copy_from_slice(self.take(SIZE)?);
        Ok(array)
    }

    /// A number's bytes, lowest first.
    fn number<const SIZE: usize>(&mut self) -> Result<[u8; SIZE], Malformed> {
        if let Some(from) = self.aligned_from {
            self.take((self.position - from).wrapping_neg() % SIZE)?;
        }
        let mut bytes = self.array()?;
        if self.order == Order::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, Malformed> {
        self.number().map(u8::from_le_bytes)
    }

    pub(crate) fn u16(&mut self) -> Result<u16, Malformed> {
        self.number().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Result<u32, Malformed> {
        self.number().map(u32::from_le_bytes)
    }

    pub(crate) fn i32(&mut self) -> Result<i32, Malformed> {
        self.number().map(i32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Result<u64, Malformed> {
        self.number().map(u64::from_le_bytes)
    }

    pub(crate) fn f64(&mut self) -> Result<f64, Malformed> {
        self.number().map(f64::from_le_bytes)
    }

    pub(crate) fn f64s<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], Malformed> {
        let mut values = [0.0; COUNT];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// How many elements follow, each of at least `least_bytes`.
    fn length(&mut self, least_bytes: usize) -> Result<usize, Malformed> {
        let count = self.u32()?;
        let left = self.left();
        match usize::try_from(count) {
            Ok(length) if length.saturating_mul(least_bytes) <= left => Ok(length),
            Ok(_) | Err(_) => Err(self.flawed(Flaw::Length { count, left })),
        }
    }

    pub(crate) fn bytes(&mut self) -> Result<&'a [u8], Malformed> {
        let length = self.length(1)?;
        self.take(length)
    }

    pub(crate) fn text(&mut self) -> Result<&'a str, Malformed> {
        let bytes = self.bytes()?;
        // CDR counts the zero at the end.
        let bytes = bytes.strip_suffix(&[0]).filter(|_| !self.is_ros1()).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| self.flawed(Flaw::Text))
    }

    pub(crate) fn sequence<T>(
        &mut self,
        least_bytes: usize,
        mut element: impl FnMut(&mut Self) -> Result<T, Malformed>,
    ) -> Result<Vec<T>, Malformed> {
        let length = self.length(least_bytes)?;
        (0..length).map(|_| element(self)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_byte_order_is_read_and_aligned_after_the_head() {
        let little = [0, 1, 0, 0, 7, 0, 0, 0, 2, 0, 0, 0];
        let mut reader = Reader::cdr(&little).unwrap();
        assert_eq!((reader.u8().unwrap(), reader.u32().unwrap()), (7, 2));
        let big = [0, 0, 0, 0, 0, 0, 0, 3, b'a', b'b', 0, 0, 0, 0, 0, 0, 0x3f, 0xf0, 0, 0, 0, 0, 0, 0];
        let mut reader = Reader::cdr(&big).unwrap();
        assert_eq!(reader.text().unwrap(), "ab");
        // Aligned to 8 from the end of the head, so the number begins at byte 12 of the message.
        assert_eq!(reader.position, 11);
        let mut padded = big[..12].to_vec();
        padded.extend(1.5_f64.to_be_bytes());
        let mut reader = Reader::cdr(&padded).unwrap();
        reader.text().unwrap();
        assert_eq!(reader.f64().unwrap().to_bits(), 1.5_f64.to_bits());
    }

    #[test]
    fn lengths_that_lie_are_named_with_their_byte() {
        let mut lying = vec![0, 1, 0, 0];
        lying.extend(u32::MAX.to_le_bytes());
        lying.extend([1, 2, 3]);
        let error = Reader::cdr(&lying).unwrap().bytes().unwrap_err();
        assert_eq!(error.to_string(), "at byte 8: a length says 4294967295 elements, and 3 bytes are left");
        let error = Reader::cdr(&lying).unwrap().sequence(8, Reader::f64).unwrap_err();
        assert_eq!(error.flaw, Flaw::Length { count: u32::MAX, left: 3 });
        let error = Reader::packed(&[1, 2]).u32().unwrap_err();
        assert_eq!(error.to_string(), "at byte 0: 4 bytes are needed and 2 are left");
        let error = Reader::cdr(&[0, 7, 0, 0]).map(|_| ()).unwrap_err();
        assert!(error.to_string().contains("0x0007 is not read"), "{error}");
    }
}
