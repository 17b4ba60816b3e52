//! A set of centres and the exact search for the nearest of them.

use super::binary_rows::BinaryRows;
use super::float_panels::FloatPanels;
use super::nearest::Nearest;
use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::DescriptorKind;

/// Rows searched together; a block and a panel of centres fit the nearest caches.
pub(crate) const BLOCK_ROWS: usize = 64;

/// Centres of one kind and width, packed for searching.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Centres {
    Float(FloatPanels),
    Binary(BinaryRows),
}

impl Centres {
    /// Packs consecutive rows of `width` bytes.
    pub(crate) fn pack(kind: DescriptorKind, width: usize, rows: &[u8]) -> Self {
        match kind {
            DescriptorKind::Float => Self::Float(FloatPanels::pack(width, rows)),
            DescriptorKind::Binary => Self::Binary(BinaryRows::pack(width, rows)),
        }
    }

    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Float(panels) => panels.len(),
            Self::Binary(rows) => rows.len(),
        }
    }

    /// The centres as they were packed.
    pub(crate) fn rows(&self) -> Vec<u8> {
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
    pub(crate) fn nearest(&self, rows: &[u8], nearest: &mut [Nearest]) {
        match self {
            Self::Float(panels) => panels.nearest(rows, nearest),
            Self::Binary(binary) => binary.nearest(rows, nearest),
        }
    }

    /// The nearest centre of one row.
    pub(crate) fn nearest_one(&self, row: &[u8]) -> Nearest {
        let mut nearest = [Nearest::default()];
        self.nearest(row, &mut nearest);
        nearest[0]
    }

    /// Distances of each row of a block from all centres in order, row by row.
    pub(crate) fn distances(&self, rows: &[u8]) -> Vec<u32> {
        match self {
            Self::Float(panels) => panels.distances(rows),
            Self::Binary(binary) => binary.distances(rows),
        }
    }

    /// Number of centres, then their bytes.
    pub(crate) fn encode(&self, writer: &mut Writer) {
        writer.varint(self.len() as u64);
        writer.raw(&self.rows());
    }

    /// Reads what [`Centres::encode`] wrote: one centre or more.
    pub(crate) fn decode(
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
mod tests;
