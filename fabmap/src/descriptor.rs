//! Local feature descriptors as rows of bytes, compared in integers.

mod distances;

pub(crate) use distances::lower_distances;

/// How two descriptor rows are compared.
///
/// Both kinds are stored as bytes: a float descriptor (SIFT, RootSIFT) is rounded to one byte a
/// dimension when it is extracted. Distances are then integers, so a descriptor has the same
/// nearest word whatever the processor's vector width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DescriptorKind {
    /// One byte a dimension; squared Euclidean distance.
    Float,
    /// One bit a dimension; Hamming distance.
    Binary,
}

impl DescriptorKind {
    /// Distance between two rows of equal width: squared Euclidean (`Float`) or number of
    /// differing bits (`Binary`). Rows longer than [`Descriptors::MAX_WIDTH`] do not occur, so it
    /// fits 32 bits.
    #[must_use]
    #[inline]
    pub fn distance(self, a: &[u8], b: &[u8]) -> u32 {
        match self {
            DescriptorKind::Float => distances::squared_euclidean(a, b),
            DescriptorKind::Binary => distances::hamming(a, b),
        }
    }
}

/// A set of descriptors of one kind and width: `len()` rows of `width()` bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Descriptors {
    kind: DescriptorKind,
    width: usize,
    bytes: Vec<u8>,
}

/// Why a set of descriptors cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DescriptorError {
    /// The width is zero or above [`Descriptors::MAX_WIDTH`].
    #[error("a descriptor of {width} bytes is not supported; use 1 to {max}", max = Descriptors::MAX_WIDTH)]
    Width {
        /// The width asked for, in bytes.
        width: usize,
    },
    /// The bytes do not fill whole rows.
    #[error("{bytes} bytes are not whole rows of {width} bytes; send complete descriptors")]
    PartialRow {
        /// Bytes given.
        bytes: usize,
        /// Bytes per row.
        width: usize,
    },
    /// Two sets that do not belong together.
    #[error(
        "descriptors of {found_width} bytes ({found:?}) do not match {expected_width} bytes ({expected:?}); \
         extract both with the same feature"
    )]
    Mismatch {
        /// Kind of the set that was there first.
        expected: DescriptorKind,
        /// Its width in bytes.
        expected_width: usize,
        /// Kind of the other set.
        found: DescriptorKind,
        /// Its width in bytes.
        found_width: usize,
    },
}

impl AsRef<Descriptors> for Descriptors {
    fn as_ref(&self) -> &Descriptors {
        self
    }
}

impl Descriptors {
    /// Widest row in bytes; keeps every squared distance within 32 bits.
    pub const MAX_WIDTH: usize = 4096;

    /// Takes `bytes` as consecutive rows of `width` bytes.
    ///
    /// # Errors
    /// [`DescriptorError::Width`] or [`DescriptorError::PartialRow`].
    pub fn new(kind: DescriptorKind, width: usize, bytes: Vec<u8>) -> Result<Self, DescriptorError> {
        if width == 0 || width > Self::MAX_WIDTH {
            return Err(DescriptorError::Width { width });
        }
        if !bytes.len().is_multiple_of(width) {
            return Err(DescriptorError::PartialRow { bytes: bytes.len(), width });
        }
        Ok(Self { kind, width, bytes })
    }

    /// How rows are compared.
    #[must_use]
    pub fn kind(&self) -> DescriptorKind {
        self.kind
    }

    /// Bytes per row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len() / self.width
    }

    /// True if there is no row: a dark or blank image has no features.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Row `index`, counted from 0.
    ///
    /// # Panics
    /// If `index` is not below [`Descriptors::len`].
    #[must_use]
    pub fn row(&self, index: usize) -> &[u8] {
        &self.bytes[index * self.width..(index + 1) * self.width]
    }

    /// All rows in order.
    pub fn rows(&self) -> std::slice::ChunksExact<'_, u8> {
        self.bytes.chunks_exact(self.width)
    }

    /// Writes the distance of `row` to each row into `distances`.
    ///
    /// # Panics
    /// If `row` is of another width, or there are not as many distances as rows.
    pub fn distances_to(&self, row: &[u8], distances: &mut [u32]) {
        assert_eq!((row.len(), distances.len()), (self.width, self.len()), "width and number of rows");
        distances.fill(u32::MAX);
        lower_distances(self.kind, row, &self.bytes, distances);
    }

    /// All rows as one slice.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Appends the rows of `other`.
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] if kind or width differ; nothing is appended then.
    pub fn append(&mut self, other: &Descriptors) -> Result<(), DescriptorError> {
        self.check_matches(other)?;
        self.bytes.extend_from_slice(&other.bytes);
        Ok(())
    }

    /// Says whether `other` can be compared with these rows.
    ///
    /// # Errors
    /// [`DescriptorError::Mismatch`] if kind or width differ.
    pub fn check_matches(&self, other: &Descriptors) -> Result<(), DescriptorError> {
        if (self.kind, self.width) == (other.kind, other.width) {
            return Ok(());
        }
        Err(DescriptorError::Mismatch {
            expected: self.kind,
            expected_width: self.width,
            found: other.kind,
            found_width: other.width,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_the_textbook_ones() {
        let (a, b) = ([0u8, 255, 3, 7, 0, 0, 0, 0, 1], [255u8, 0, 5, 7, 0, 0, 0, 0, 3]);
        assert_eq!(DescriptorKind::Float.distance(&a, &b), 2 * 255 * 255 + 4 + 4);
        assert_eq!(DescriptorKind::Binary.distance(&a, &b), 8 + 8 + 2 + 1);
    }

    #[test]
    fn the_widest_rows_do_not_overflow() {
        let (low, high) = (vec![0u8; Descriptors::MAX_WIDTH], vec![255u8; Descriptors::MAX_WIDTH]);
        assert_eq!(DescriptorKind::Float.distance(&low, &high), 4096 * 255 * 255);
    }

    #[test]
    fn rows_that_are_not_whole_are_refused() {
        let partial = Descriptors::new(DescriptorKind::Binary, 32, vec![0; 33]);
        assert_eq!(partial, Err(DescriptorError::PartialRow { bytes: 33, width: 32 }));
        let none = Descriptors::new(DescriptorKind::Float, 0, Vec::new());
        assert_eq!(none, Err(DescriptorError::Width { width: 0 }));
    }

    #[test]
    fn only_like_descriptors_are_joined() {
        let mut sift = Descriptors::new(DescriptorKind::Float, 2, vec![1, 2]).unwrap();
        let orb = Descriptors::new(DescriptorKind::Binary, 2, vec![3, 4]).unwrap();
        assert!(matches!(sift.append(&orb), Err(DescriptorError::Mismatch { .. })));
        let more = Descriptors::new(DescriptorKind::Float, 2, vec![5, 6, 7, 8]).unwrap();
        sift.append(&more).unwrap();
        assert_eq!(sift.len(), 3);
        assert_eq!(sift.row(2), [7, 8]);
    }
}
