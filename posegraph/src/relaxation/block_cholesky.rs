//! Symmetric systems of small dense blocks, solved by sparse Cholesky.
//!
//! The elimination order is found among blocks, which are far fewer than their scalars, and kept as
//! long as the structure stays. One thread: the same bits always.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{FaerError, SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side};
use nalgebra::SMatrix;

/// A symmetric matrix of `D` by `D` blocks, with room for its factor.
pub(super) struct BlockCholesky<const D: usize> {
    /// Where each unknown stands in the order of elimination.
    position: Vec<usize>,
    /// Where the values of each block column begin, in that order.
    begins: Vec<usize>,
    /// Blocks above the diagonal, in each block column.
    above: Vec<usize>,
    /// The upper triangle, by columns.
    pattern: SymbolicSparseColMat<usize>,
    values: Vec<f64>,
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    memory: MemBuffer,
    permuted: Vec<f64>,
}

/// Where the values of a block lie that joins two unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Slot {
    begin: usize,
    stride: usize,
    orientation: Orientation,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Orientation {
    AsGiven,
    Transposed,
}

/// The matrix is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotPositiveDefinite;

impl<const D: usize> BlockCholesky<D> {
    /// `pairs` of unknowns that share a block, in any order; a pair may come more than once.
    pub(super) fn new(unknowns: usize, pairs: &[(usize, usize)]) -> Self {
        let position = elimination_order(unknowns, pairs);
        let columns = block_columns(unknowns, pairs, &position);
        let above: Vec<usize> = columns.iter().map(Vec::len).collect();
        let mut begins = Vec::with_capacity(unknowns + 1);
        let mut column_begins = vec![0];
        let mut rows = Vec::new();
        for (column, blocks) in columns.iter().enumerate() {
            begins.push(rows.len());
            for k in 0..D {
                rows.extend(blocks.iter().flat_map(|block| block * D..(block + 1) * D));
                rows.extend(column * D..=column * D + k);
                column_begins.push(rows.len());
            }
        }
        begins.push(rows.len());
        let size = unknowns * D;
        let values = vec![0.0; rows.len()];
        let pattern = SymbolicSparseColMat::new_checked(size, size, column_begins, None, rows);
        let parameters = CholeskySymbolicParams::default();
        let symbolic = within_memory(factorize_symbolic_cholesky(
            pattern.as_ref(),
            Side::Upper,
            SymmetricOrdering::Identity,
            parameters,
        ));
        let needed = StackReq::or(
            symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, faer::Spec::default()),
            symbolic.solve_in_place_scratch::<f64>(D, Par::Seq),
        );
        let factor = vec![0.0; symbolic.len_val()];
        let memory = MemBuffer::new(needed);
        Self { position, begins, above, pattern, values, symbolic, factor, memory, permuted: Vec::new() }
    }

    /// Where the block lies whose rows belong to one unknown and whose columns to the other.
    ///
    /// # Panics
    /// If the two are no pair that the matrix was made with.
    #[expect(clippy::expect_used, reason = "pairs come from the same edges as the structure")]
    pub(super) fn slot(&self, row: usize, column: usize) -> Slot {
        let row = self.position[row];
        let column = self.position[column];
        let upper = row.min(column);
        let lower = row.max(column);
        let begin = self.begins[lower];
        let blocks = &self.pattern.row_idx()[begin..begin + self.above[lower] * D];
        // Rows of the column's first scalar, so a block's first row is every D-th.
        let place = blocks.partition_point(|&scalar| scalar < upper * D);
        assert_eq!(blocks.get(place).copied().expect("the two share a block"), upper * D);
        let orientation = if row < column { Orientation::AsGiven } else { Orientation::Transposed };
        Slot { begin: begin + place, stride: self.above[lower] * D, orientation }
    }

    /// All zero again.
    pub(super) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds to the block on the diagonal; only its upper triangle is looked at.
    pub(super) fn add_diagonal(&mut self, unknown: usize, block: &SMatrix<f64, D, D>) {
        let column = self.position[unknown];
        let mut begin = self.begins[column];
        let stride = self.above[column] * D;
        for k in 0..D {
            begin += stride;
            for (row, value) in self.values[begin..=begin + k].iter_mut().enumerate() {
                *value += block[(row, k)];
            }
            begin += k + 1;
        }
    }

    /// Adds to a block off the diagonal.
    pub(super) fn add(&mut self, slot: Slot, block: &SMatrix<f64, D, D>) {
        let mut begin = slot.begin;
        for k in 0..D {
            let values = &mut self.values[begin..begin + D];
            match slot.orientation {
                Orientation::AsGiven => {
                    values.iter_mut().enumerate().for_each(|(row, value)| *value += block[(row, k)]);
                }
                Orientation::Transposed => {
                    values.iter_mut().enumerate().for_each(|(row, value)| *value += block[(k, row)]);
                }
            }
            begin += slot.stride + k + 1;
        }
    }

    /// The diagonal, unknown by unknown.
    pub(super) fn diagonal(&self) -> Vec<f64> {
        let mut diagonal = Vec::with_capacity(self.position.len() * D);
        for &column in &self.position {
            diagonal.extend((0..D).map(|k| self.values[self.diagonal_index(column, k)]));
        }
        diagonal
    }

    /// Puts other values on the diagonal, in the order of [`BlockCholesky::diagonal`].
    pub(super) fn set_diagonal(&mut self, diagonal: impl Iterator<Item = f64>) {
        let mut diagonal = diagonal;
        for unknown in 0..self.position.len() {
            for k in 0..D {
                let index = self.diagonal_index(self.position[unknown], k);
                if let Some(value) = diagonal.next() {
                    self.values[index] = value;
                }
            }
        }
    }

    fn diagonal_index(&self, column: usize, k: usize) -> usize {
        self.begins[column] + (k + 1) * self.above[column] * D + k * (k + 1) / 2 + k
    }

    /// Solves for as many right sides as `right_sides` has, each unknown by unknown, one after the
    /// other.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] if the matrix is not; the right sides are as before then.
    pub(super) fn solve(&mut self, right_sides: &mut [f64]) -> Result<(), NotPositiveDefinite> {
        let size = self.position.len() * D;
        if size == 0 {
            return Ok(());
        }
        let stack = MemStack::new(&mut self.memory);
        let factor = self
            .symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(self.pattern.as_ref(), &self.values),
                Side::Upper,
                LltRegularization::default(),
                Par::Seq,
                stack,
                faer::Spec::default(),
            )
            .map_err(|_| NotPositiveDefinite)?;
        for right_side in right_sides.chunks_exact_mut(size) {
            permuted_solve::<D>(factor, &self.position, right_side, &mut self.permuted, stack);
        }
        Ok(())
    }
}

fn permuted_solve<const D: usize>(
    factor: LltRef<'_, usize, f64>,
    position: &[usize],
    right_side: &mut [f64],
    permuted: &mut Vec<f64>,
    stack: &mut MemStack,
) {
    permuted.resize(right_side.len(), 0.0);
    for (unknown, &place) in position.iter().enumerate() {
        permuted[place * D..(place + 1) * D].copy_from_slice(&right_side[unknown * D..(unknown + 1) * D]);
    }
    let columns = MatMut::from_column_major_slice_mut(permuted, right_side.len(), 1);
    factor.solve_in_place_with_conj(Conj::No, columns, Par::Seq, stack);
    for (unknown, &place) in position.iter().enumerate() {
        right_side[unknown * D..(unknown + 1) * D].copy_from_slice(&permuted[place * D..(place + 1) * D]);
    }
}

/// Approximate minimum degree among blocks: position of each unknown.
fn elimination_order(unknowns: usize, pairs: &[(usize, usize)]) -> Vec<usize> {
    let identity: Vec<usize> = (0..unknowns).collect();
    let columns = block_columns(unknowns, pairs, &identity);
    let mut begins = vec![0];
    let mut rows = Vec::new();
    for column in &columns {
        rows.extend_from_slice(column);
        begins.push(rows.len());
    }
    let entries = rows.len();
    let pattern = SymbolicSparseColMat::new_checked(unknowns, unknowns, begins, None, rows);
    let mut order = vec![0; unknowns];
    let mut position = vec![0; unknowns];
    let mut memory = MemBuffer::new(amd::order_maybe_unsorted_scratch::<usize>(unknowns, entries));
    within_memory(amd::order_maybe_unsorted(
        &mut order,
        &mut position,
        pattern.as_ref(),
        amd::Control::default(),
        MemStack::new(&mut memory),
    ));
    position
}

/// For each block column, in the order given by `position`, the blocks above the diagonal,
/// ascending.
fn block_columns(unknowns: usize, pairs: &[(usize, usize)], position: &[usize]) -> Vec<Vec<usize>> {
    let mut columns = vec![Vec::new(); unknowns];
    for &(one, other) in pairs {
        let one = position[one];
        let other = position[other];
        columns[one.max(other)].push(one.min(other));
    }
    for column in &mut columns {
        column.sort_unstable();
        column.dedup();
    }
    columns
}

/// What is left to fail is memory, and then all else fails as well.
#[expect(clippy::panic, reason = "as every allocation of the standard library does")]
fn within_memory<T>(outcome: Result<T, FaerError>) -> T {
    outcome.unwrap_or_else(|error| panic!("the pose graph's matrix does not fit into memory: {error}"))
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    const UNKNOWNS: usize = 12;

    proptest! {
        /// The oracle is dense.
        #[test]
        fn it_solves_what_dense_cholesky_solves(
            pairs in prop::collection::vec((0..UNKNOWNS, 0..UNKNOWNS), 0..40),
            numbers in prop::collection::vec(-1.0..1.0f64, 400),
        ) {
            let pairs: Vec<_> = pairs.into_iter().filter(|(one, other)| one != other).collect();
            let mut sparse = BlockCholesky::<2>::new(UNKNOWNS, &pairs);
            let mut dense = DMatrix::zeros(2 * UNKNOWNS, 2 * UNKNOWNS);
            for unknown in 0..UNKNOWNS {
                let block = SMatrix::<f64, 2, 2>::new(300.0, 1.0, 1.0, 200.0);
                sparse.add_diagonal(unknown, &block);
                dense.fixed_view_mut::<2, 2>(2 * unknown, 2 * unknown).copy_from(&block);
            }
            for (number, &(row, column)) in pairs.iter().enumerate() {
                let block = SMatrix::<f64, 2, 2>::from_fn(|i, k| numbers[4 * number + 2 * i + k]);
                sparse.add(sparse.slot(row, column), &block);
                let mut view = dense.fixed_view_mut::<2, 2>(2 * row, 2 * column);
                view += block;
                let mut view = dense.fixed_view_mut::<2, 2>(2 * column, 2 * row);
                view += block.transpose();
            }
            prop_assert_eq!(sparse.diagonal(), dense.diagonal().as_slice().to_vec());
            let right = DVector::from_fn(4 * UNKNOWNS, |i, _| numbers[i]);
            let mut solved = right.clone();
            sparse.solve(solved.as_mut_slice()).unwrap();
            let both = right.reshape_generic(nalgebra::Dyn(2 * UNKNOWNS), nalgebra::Dyn(2));
            let expected = dense.cholesky().unwrap().solve(&both);
            let difference = expected.as_slice().iter().zip(solved.iter()).map(|(a, b)| (a - b).abs());
            prop_assert!(difference.fold(0.0, f64::max) < 1e-12);
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_told() {
        let mut system = BlockCholesky::<2>::new(2, &[(1, 0)]);
        (0..2).for_each(|unknown| system.add_diagonal(unknown, &SMatrix::identity()));
        system.add(system.slot(0, 1), &(SMatrix::identity() * 2.0));
        let mut right_side = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(system.solve(&mut right_side), Err(NotPositiveDefinite));
        assert_eq!(right_side, [1.0, 2.0, 3.0, 4.0]);
        system.set_diagonal([3.0; 4].into_iter());
        assert_eq!(system.solve(&mut right_side), Ok(()));
        assert!(
            right_side.iter().zip([-0.6, -0.4, 1.4, 1.6]).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-12)
        );
    }
}
