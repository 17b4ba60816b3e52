//! Which features of two views are the same thing.

use std::collections::BTreeMap;

use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::observation::WordId;
use nalgebra::DMatrix;

use crate::feature_record::FeatureRecord;

/// Features of two views that look alike, by their indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Index of the feature in the earlier view.
    pub earlier: usize,
    /// Index of the feature in the current view.
    pub current: usize,
    /// Looks like nothing else in either view.
    pub distinct: bool,
}

/// Distance to the nearest feature, as a share of that to the second nearest, up to which a match
/// is distinct. Lowe (IJCV 2004) drops matches above 0.8. They are kept here, at half the weight:
/// over seasons and in dim corridors most true ones are among them, and the motion sorts them out.
const DISTINCT_RATIO: f64 = 0.9;

/// A word that a view shows more often than this does not say which feature is which.
const MAX_REPEATED_WORD: usize = 2;

/// Features that are each other's nearest. Views without descriptors of one kind are matched by
/// words.
///
/// Every descriptor is compared with every other: against looking at those of the same word alone,
/// this finds half as many true matches again, for two to three milliseconds at 500 features.
pub(crate) fn matches(earlier: &FeatureRecord, current: &FeatureRecord) -> Vec<Match> {
    match (earlier.descriptors(), current.descriptors()) {
        (Some(from), Some(to)) if from.check_matches(to).is_ok() => mutual_nearest(&distances(from, to)),
        (Some(_) | None, Some(_) | None) => of_same_word(earlier.words(), current.words()),
    }
}

/// Descriptors of one kind that are each other's nearest; none of kinds that differ.
pub(crate) fn descriptor_matches(earlier: &Descriptors, current: &Descriptors) -> Vec<Match> {
    if earlier.check_matches(current).is_ok() {
        mutual_nearest(&distances(earlier, current))
    } else {
        Vec::new()
    }
}

fn of_same_word(earlier: &[WordId], current: &[WordId]) -> Vec<Match> {
    let mut showing: BTreeMap<WordId, [Vec<usize>; 2]> = BTreeMap::new();
    for (view, words) in [earlier, current].into_iter().enumerate() {
        for (feature, &word) in words.iter().enumerate() {
            showing.entry(word).or_default()[view].push(feature);
        }
    }
    let mut matches = Vec::new();
    for [from, to] in
        showing.values().filter(|views| views.iter().all(|view| view.len() <= MAX_REPEATED_WORD))
    {
        let distinct = from.len() == 1 && to.len() == 1;
        for &earlier in from {
            matches.extend(to.iter().map(|&current| Match { earlier, current, distinct }));
        }
    }
    matches
}

/// Entry (i, j) is the distance of row i of `from` to row j of `to`; squared, where they are
/// Euclidean.
fn distances(from: &Descriptors, to: &Descriptors) -> DMatrix<u32> {
    match from.kind() {
        DescriptorKind::Float if from.width() <= MAX_EXACT_WIDTH => by_product(from, to),
        DescriptorKind::Float | DescriptorKind::Binary => {
            let mut distances = DMatrix::zeros(from.len(), to.len());
            let columns = distances.as_mut_slice().chunks_exact_mut(from.len().max(1));
            to.rows().zip(columns).for_each(|(row, column)| from.distances_to(row, column));
            distances
        }
    }
}

/// Sums of as many products of two bytes are whole numbers that an `f32` holds exactly, in whatever
/// order they are added: 2^24 / 255^2.
const MAX_EXACT_WIDTH: usize = 258;

/// |a - b|² = |a|² + |b|² - 2ab, with all products in one multiplication of matrices.
fn by_product(from: &Descriptors, to: &Descriptors) -> DMatrix<u32> {
    let values = |set: &Descriptors| set.as_bytes().iter().map(|&byte| f32::from(byte)).collect::<Vec<_>>();
    let squares = |set: &Descriptors| -> Vec<u32> {
        set.rows().map(|row| row.iter().map(|&byte| u32::from(byte).pow(2)).sum()).collect()
    };
    let (from_squares, to_squares) = (squares(from), squares(to));
    let from_rows = DMatrix::from_row_slice(from.len(), from.width(), &values(from));
    let products = from_rows * DMatrix::from_vec(to.width(), to.len(), values(to));
    let mut distances = DMatrix::zeros(from.len(), to.len());
    let column_length = from.len().max(1);
    let columns = distances.as_mut_slice().chunks_exact_mut(column_length);
    let columns = columns.zip(products.as_slice().chunks_exact(column_length));
    for ((distances, products), to_square) in columns.zip(to_squares) {
        for ((distance, &product), from_square) in distances.iter_mut().zip(products).zip(&from_squares) {
            // By way of an i32, for which processors have an instruction.
            *distance = from_square + to_square - 2 * (product as i32 as u32);
        }
    }
    distances
}

/// The nearest of one feature's counterparts, and how near the second is.
#[derive(Clone, Copy)]
struct Nearest {
    index: usize,
    distance: u32,
    second: u32,
}

impl Nearest {
    const NONE: Self = Self { index: usize::MAX, distance: u32::MAX, second: u32::MAX };

    fn take(&mut self, index: usize, distance: u32) {
        if distance < self.distance {
            *self = Self { index, distance, second: self.distance };
        } else if distance < self.second {
            self.second = distance;
        }
    }
}

fn mutual_nearest(distances: &DMatrix<u32>) -> Vec<Match> {
    let (rows, columns) = distances.shape();
    let (mut of_row, mut of_column) = (vec![Nearest::NONE; rows], vec![Nearest::NONE; columns]);
    for (column, nearest) in of_column.iter_mut().enumerate() {
        for (row, &distance) in distances.column(column).iter().enumerate() {
            nearest.take(row, distance);
            of_row[row].take(column, distance);
        }
    }
    let mutual = |(earlier, nearest): (usize, &Nearest)| {
        let back = of_column.get(nearest.index).filter(|back| back.index == earlier)?;
        let limit = DISTINCT_RATIO.powi(2) * f64::from(nearest.second.min(back.second));
        Some(Match { earlier, current: nearest.index, distinct: f64::from(nearest.distance) <= limit })
    };
    of_row.iter().enumerate().filter_map(mutual).collect()
}

#[cfg(test)]
mod tests;
