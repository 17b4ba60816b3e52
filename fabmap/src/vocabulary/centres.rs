//! A set of centres and the exact search for the nearest of them.

use super::binary_rows::BinaryRows;
use super::float_panels::FloatPanels;
use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::DescriptorKind;

/// Rows searched together; a block and a panel of centres fit the nearest caches.
pub(super) const BLOCK_ROWS: usize = 64;

/// Centres of one kind and width, packed for searching.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Centres {
    Float(FloatPanels),
    Binary(BinaryRows),
}

/// The centre nearest to a row, and its distance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Nearest {
    pub(super) id: u32,
    pub(super) distance: u32,
}

impl Nearest {
    /// Takes a centre that is nearer than the one so far; offered in rising order, the lowest
    /// number stays among equals.
    #[inline(always)]
    pub(super) fn improve(&mut self, id: u32, distance: u32) {
        if distance < self.distance {
            *self = Self { id, distance };
        }
    }
}

impl Centres {
    /// Packs consecutive rows of `width` bytes.
    pub(super) fn pack(kind: DescriptorKind, width: usize, rows: &[u8]) -> Self {
        match kind {
            DescriptorKind::Float => Self::Float(FloatPanels::pack(width, rows)),
            DescriptorKind::Binary => Self::Binary(BinaryRows::pack(width, rows)),
        }
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Self::Float(panels) => panels.len(),
            Self::Binary(rows) => rows.len(),
        }
    }

    /// The centres as they were packed.
    pub(super) fn rows(&self) -> Vec<u8> {
        let mut rows = Vec::new();
        for index in 0..self.len() {
            match self {
                Self::Float(panels) => panels.unpack(index, &mut rows),
                Self::Binary(binary) => binary.unpack(index, &mut rows),
            }
        }
        rows
    }

    /// The nearest centre of each of a block of rows, the lowest number among equals.
    pub(super) fn nearest(&self, rows: &[u8], nearest: &mut [Nearest]) {
        match self {
            Self::Float(panels) => panels.nearest(rows, nearest),
            Self::Binary(binary) => binary.nearest(rows, nearest),
        }
    }

    /// The nearest centre of one row.
    pub(super) fn nearest_one(&self, row: &[u8]) -> Nearest {
        let mut nearest = [Nearest::default()];
        self.nearest(row, &mut nearest);
        nearest[0]
    }

    /// Distances of each row of a block from all centres in order, row by row.
    pub(super) fn distances(&self, rows: &[u8]) -> Vec<u32> {
        match self {
            Self::Float(panels) => panels.distances(rows),
            Self::Binary(binary) => binary.distances(rows),
        }
    }

    /// Number of centres, then their bytes.
    pub(super) fn encode(&self, writer: &mut Writer) {
        writer.varint(self.len() as u64);
        writer.raw(&self.rows());
    }

    /// Reads what [`Centres::encode`] wrote: one centre or more.
    pub(super) fn decode(
        kind: DescriptorKind,
        width: usize,
        reader: &mut Reader<'_>,
    ) -> Result<Self, DecodeError> {
        let len = reader.count(width)?;
        if len == 0 || u32::try_from(len).is_err() {
            return Err(DecodeError::invalid(format_args!("a set of {len} words")));
        }
        Ok(Self::pack(kind, width, reader.raw(len * width)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KINDS: [DescriptorKind; 2] = [DescriptorKind::Float, DescriptorKind::Binary];

    fn brute_force(kind: DescriptorKind, width: usize, centres: &[u8], row: &[u8]) -> Nearest {
        let distances = centres.chunks_exact(width).map(|centre| kind.distance(centre, row));
        let (distance, id) = distances.zip(0..).min().unwrap();
        Nearest { id, distance }
    }

    /// Rows of few different bytes, so that equal distances are common.
    fn rows(len: std::ops::Range<usize>) -> impl Strategy<Value = (usize, Vec<u8>, Vec<u8>)> {
        (1..70usize, len, 1..70usize, any::<bool>()).prop_flat_map(|(width, centres, queries, extreme)| {
            let byte =
                move || if extreme { prop_oneof![Just(0u8), Just(255)].boxed() } else { (0..4u8).boxed() };
            let bytes = move |len| proptest::collection::vec(byte(), len);
            (Just(width), bytes(width * centres), bytes(width * queries))
        })
    }

    proptest! {
        #[test]
        fn the_nearest_is_that_of_brute_force((width, centres, queries) in rows(1..60)) {
            for kind in KINDS {
                let packed = Centres::pack(kind, width, &centres);
                let mut nearest = vec![Nearest::default(); queries.len() / width];
                packed.nearest(&queries, &mut nearest);
                let distances = packed.distances(&queries);
                let distances = distances.chunks_exact(packed.len());
                for ((nearest, query), distances) in nearest.iter().zip(queries.chunks_exact(width)).zip(distances) {
                    prop_assert_eq!(*nearest, brute_force(kind, width, &centres, query));
                    prop_assert_eq!(packed.nearest_one(query), *nearest);
                    let expected: Vec<u32> =
                        centres.chunks_exact(width).map(|centre| kind.distance(centre, query)).collect();
                    prop_assert_eq!(distances, &expected[..]);
                    prop_assert_eq!(packed.distances(query), expected);
                }
            }
        }

        #[test]
        fn centres_come_back_as_they_were((width, centres, _) in rows(1..60)) {
            for kind in KINDS {
                prop_assert_eq!(&Centres::pack(kind, width, &centres).rows(), &centres);
            }
        }
    }

    #[test]
    fn the_widest_and_brightest_rows_do_not_overflow() {
        let width = crate::descriptor::Descriptors::MAX_WIDTH;
        let centres = [vec![0; width], vec![255; width], vec![128; width]].concat();
        let panels = Centres::pack(DescriptorKind::Float, width, &centres);
        let expected = DescriptorKind::Float.distance(&vec![0; width], &vec![255; width]);
        assert_eq!(panels.distances(&vec![255; width])[..2], [expected, 0]);
        assert_eq!(panels.nearest_one(&vec![250; width]).id, 1);
        assert_eq!(panels.nearest_one(&vec![0; width]), Nearest { id: 0, distance: 0 });
    }
}
