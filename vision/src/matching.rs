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
/// this finds half as many true matches again. It takes the larger part of what
/// `cargo bench -p waypost-vision --bench verification -- similarity` measures.
pub(crate) fn matches(earlier: &FeatureRecord, current: &FeatureRecord) -> Vec<Match> {
    match (earlier.descriptors(), current.descriptors()) {
        (Some(from), Some(to)) if from.check_matches(to).is_ok() => mutual_nearest(from, to),
        (Some(_) | None, Some(_) | None) => of_same_word(earlier.words(), current.words()),
    }
}

/// Descriptors of one kind that are each other's nearest; none of kinds that differ.
pub(crate) fn descriptor_matches(earlier: &Descriptors, current: &Descriptors) -> Vec<Match> {
    if earlier.check_matches(current).is_ok() { mutual_nearest(earlier, current) } else { Vec::new() }
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

fn mutual_nearest(from: &Descriptors, to: &Descriptors) -> Vec<Match> {
    let mut nearest = Nearest::of(from.len());
    each_column(from, to, |distances| nearest.take(distances));
    nearest.mutual()
}

/// Calls `take` with how far each descriptor of `to`, one after the other, is from all of `from`;
/// squared, where distances are Euclidean.
fn each_column(from: &Descriptors, to: &Descriptors, mut take: impl FnMut(&[u32])) {
    match from.kind() {
        DescriptorKind::Float if from.width() <= MAX_EXACT_WIDTH => by_product(from, to, take),
        DescriptorKind::Float | DescriptorKind::Binary => {
            let mut distances = vec![0; from.len()];
            for row in to.rows() {
                from.distances_to(row, &mut distances);
                take(&distances);
            }
        }
    }
}

/// Sums of as many products of two bytes are whole numbers that an `f32` holds exactly, in whatever
/// order they are added: 2^24 / 255^2.
const MAX_EXACT_WIDTH: usize = 258;

/// Columns that are multiplied at once: with 500 features, their products stay in the cache of a
/// core, and no large matrix is asked of the system for every two views.
const COLUMNS_AT_ONCE: usize = 64;

/// |a - b|² = |a|² + |b|² - 2ab, with the products of many in one multiplication of matrices.
fn by_product(from: &Descriptors, to: &Descriptors, mut take: impl FnMut(&[u32])) {
    let (height, width) = (from.len().max(1), from.width());
    let values = |bytes: &[u8]| bytes.iter().map(|&byte| f32::from(byte)).collect::<Vec<_>>();
    let square = |row: &[u8]| row.iter().map(|&byte| u32::from(byte).pow(2)).sum::<u32>();
    let from_rows = DMatrix::from_row_slice(from.len(), width, &values(from.as_bytes()));
    let from_squares: Vec<u32> = from.rows().map(square).collect();
    let mut products = DMatrix::zeros(from.len(), COLUMNS_AT_ONCE);
    let mut distances = vec![0; from.len()];
    for rows in to.as_bytes().chunks(COLUMNS_AT_ONCE * width) {
        let to_columns = DMatrix::from_vec(width, rows.len() / width, values(rows));
        products.columns_mut(0, to_columns.ncols()).gemm(1.0, &from_rows, &to_columns, 0.0);
        for (products, row) in products.as_slice().chunks_exact(height).zip(rows.chunks_exact(width)) {
            let to_square = square(row);
            for ((distance, &product), from_square) in distances.iter_mut().zip(products).zip(&from_squares) {
                // By way of an i32, for which processors have an instruction.
                *distance = from_square + to_square - 2 * (product as i32 as u32);
            }
            take(&distances);
        }
    }
}

/// What each feature is nearest to, and how near the second is. Of rows, as far as columns were
/// taken in.
struct Nearest {
    /// The nearest column of each row. Three lists, so that a processor takes in many rows at once.
    columns: Vec<u32>,
    distances: Vec<u32>,
    seconds: Vec<u32>,
    of_columns: Vec<NearestRow>,
}

#[derive(Clone, Copy)]
struct NearestRow {
    row: usize,
    second: u32,
}

impl Nearest {
    fn of(rows: usize) -> Self {
        let unknown = || vec![u32::MAX; rows];
        Self { columns: unknown(), distances: unknown(), seconds: unknown(), of_columns: Vec::new() }
    }

    /// Takes in the next column: how far it is from each row.
    fn take(&mut self, column: &[u32]) {
        let number = u32::try_from(self.of_columns.len()).unwrap_or(u32::MAX);
        let rows = self.columns.iter_mut().zip(&mut self.distances).zip(&mut self.seconds);
        for (((nearest, least), second), &distance) in rows.zip(column) {
            *second = distance.max(*least).min(*second);
            *nearest = if distance < *least { number } else { *nearest };
            *least = distance.min(*least);
        }
        self.of_columns.extend(NearestRow::of(column));
    }

    fn mutual(&self) -> Vec<Match> {
        let mutual = |(earlier, &column): (usize, &u32)| {
            let current = usize::try_from(column).ok()?;
            let back = self.of_columns.get(current).filter(|back| back.row == earlier)?;
            let limit = DISTINCT_RATIO.powi(2) * f64::from(self.seconds[earlier].min(back.second));
            Some(Match { earlier, current, distinct: f64::from(self.distances[earlier]) <= limit })
        };
        self.columns.iter().enumerate().filter_map(mutual).collect()
    }
}

impl NearestRow {
    /// `None` of no rows. The first of those that are as near.
    fn of(distances: &[u32]) -> Option<Self> {
        let least = |distances: &[u32]| distances.iter().copied().min();
        let nearest = least(distances)?;
        let row = distances.iter().position(|&distance| distance == nearest)?;
        let others = [least(&distances[..row]), least(&distances[row + 1..])];
        Some(Self { row, second: others.into_iter().flatten().min().unwrap_or(u32::MAX) })
    }
}

#[cfg(test)]
mod tests;
