//! The descriptors a vocabulary is trained on, each distinct row once.

use crate::descriptor::{DescriptorKind, Descriptors};
use rayon::prelude::*;

/// Distinct rows in ascending byte order, each with how often it occurs.
///
/// The order makes training independent of the order in which images came.
pub(super) struct TrainingSet<'a> {
    pub(super) kind: DescriptorKind,
    pub(super) width: usize,
    pub(super) rows: Vec<&'a [u8]>,
    pub(super) weights: Vec<u64>,
}

impl<'a> TrainingSet<'a> {
    pub(super) fn new(descriptors: &'a Descriptors) -> Self {
        let mut sorted: Vec<&[u8]> = descriptors.rows().collect();
        sorted.par_sort_unstable();
        let (rows, weights) =
            sorted.chunk_by(|a, b| a == b).map(|equal| (equal[0], equal.len() as u64)).unzip();
        Self { kind: descriptors.kind(), width: descriptors.width(), rows, weights }
    }

    /// The rows `members`, given in ascending order.
    pub(super) fn subset(&self, members: &[usize]) -> Self {
        Self {
            kind: self.kind,
            width: self.width,
            rows: members.iter().map(|&row| self.rows[row]).collect(),
            weights: members.iter().map(|&row| self.weights[row]).collect(),
        }
    }

    /// Number of distinct rows.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }
}
