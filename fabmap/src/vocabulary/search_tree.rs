//! A vocabulary too large to compare with every word: words in cells, searched best cell first.

use super::centres::{BLOCK_ROWS, Centres, Nearest};
use super::kmeans::{self, Cancelled, Clusters, Step};
use super::training_set::TrainingSet;
use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::DescriptorKind;
use crate::observation::WordId;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::ControlFlow;

/// Cells are visited, nearest first, until a descriptor was compared with this many words. On SIFT
/// descriptors of images not trained on, by which the number was chosen, 99% get the nearest of 100,000 words then.
const WORDS_COMPARED: u32 = 2048;

/// The same in trees of the first stored form, which does not say it: what they were made to be
/// searched with remains, for a map's words must not change.
pub(super) const FIRST_FORM_WORDS_COMPARED: u32 = 8192;

/// Most rows looked up together: enough that hundreds of them meet in a cell.
pub(super) const TREE_BLOCK_ROWS: usize = 4096;

/// Cells trained between two calls of the observer. Threads that find no cell help with the rows of
/// another's.
const CELLS_PER_STEP: usize = 4;

/// A tree of two levels: about √W cells, found by k-means over all descriptors, and in each cell
/// its words, found by k-means over the cell's descriptors.
///
/// A descriptor's nearest word often lies across the border of its nearest cell, so more cells are
/// searched, best first. What is found is the nearest word of the cells visited.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SearchTree {
    cells: Centres,
    /// Words of each cell. Words are numbered through all cells in order.
    words: Vec<Centres>,
    /// Number of the first word of each cell.
    first_words: Vec<WordId>,
    /// Cells are visited until a descriptor was compared with this many words.
    words_compared: u32,
}

/// How far training has come.
#[derive(Clone, Copy, Debug)]
pub(super) enum TreeStep {
    /// Clustering into cells.
    Cells(Step),
    /// Clustering each cell into words.
    Words { trained: u32, cells: u32 },
}

impl SearchTree {
    /// Trains a tree of exactly `words` words, at most as many as the set has rows.
    pub(super) fn train(
        set: &TrainingSet<'_>,
        words: usize,
        iterations: u32,
        seed: u64,
        observer: &mut dyn FnMut(TreeStep) -> ControlFlow<()>,
    ) -> Result<Self, Cancelled> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let cells = kmeans::cluster(set, words.isqrt(), iterations, &mut random, &mut |step| {
            observer(TreeStep::Cells(step))
        })?;
        let members = cells.members(set.width);
        let shares = shares(&members, set.len(), words);
        let mut centres = Vec::with_capacity(members.len());
        for (step, (members, shares)) in
            members.chunks(CELLS_PER_STEP).zip(shares.chunks(CELLS_PER_STEP)).enumerate()
        {
            let (trained, cells) = (centres.len() as u32, cells.centres.len() / set.width);
            Cancelled::unless_continued(observer(TreeStep::Words { trained, cells: cells as u32 }))?;
            let trained: Result<Vec<Clusters>, Cancelled> = members
                .par_iter()
                .zip(shares)
                .enumerate()
                .map(|(index, (members, &share))| {
                    let mut random = ChaCha8Rng::seed_from_u64(seed);
                    random.set_stream((step * CELLS_PER_STEP + index + 1) as u64);
                    let continued = &mut |_| ControlFlow::Continue(());
                    kmeans::cluster(&set.subset(members), share, iterations, &mut random, continued)
                })
                .collect();
            centres.extend(
                trained?.into_iter().map(|clusters| Centres::pack(set.kind, set.width, &clusters.centres)),
            );
        }
        Ok(Self::new(Centres::pack(set.kind, set.width, &cells.centres), centres, WORDS_COMPARED))
    }

    fn new(cells: Centres, words: Vec<Centres>, words_compared: u32) -> Self {
        let mut next = 0;
        let first_words = words
            .iter()
            .map(|words| {
                let first = next;
                next += words.len() as WordId;
                first
            })
            .collect();
        Self { cells, words, first_words, words_compared }
    }

    pub(super) fn len(&self) -> usize {
        self.words.iter().map(Centres::len).sum()
    }

    /// For each of consecutive rows the nearest word of the cells it visits, the lowest number among
    /// equals.
    ///
    /// Which cells those are is settled first; then each cell is compared with all its visitors
    /// together, so that its words come from memory once.
    pub(super) fn words(&self, width: usize, rows: &[u8], words: &mut [WordId]) {
        let mut best = vec![(u32::MAX, WordId::MAX); words.len()];
        let (mut visiting, mut nearest) = (Vec::new(), Vec::new());
        for (cell, visitors) in self.visitors(width, rows).iter().enumerate() {
            visiting.clear();
            for &row in visitors {
                visiting.extend_from_slice(&rows[row * width..(row + 1) * width]);
            }
            nearest.resize(visitors.len(), Nearest::default());
            self.words[cell].nearest(&visiting, &mut nearest);
            for (&row, nearest) in visitors.iter().zip(&nearest) {
                best[row] = best[row].min((nearest.distance, self.first_words[cell] + nearest.id));
            }
        }
        for (word, (_, nearest)) in words.iter_mut().zip(best) {
            *word = nearest;
        }
    }

    /// The rows that visit each cell.
    fn visitors(&self, width: usize, rows: &[u8]) -> Vec<Vec<usize>> {
        let mut visitors = vec![Vec::new(); self.words.len()];
        let mut nearest_cells = BinaryHeap::new();
        let mut row = 0;
        for block in rows.chunks(BLOCK_ROWS * width) {
            for distances in self.cells.distances(block).chunks_exact(self.words.len()) {
                // Distance and cell side by side in one integer, which compares faster than a pair.
                let mut order = nearest_cells.into_vec();
                order.clear();
                let cells = distances.iter().zip(0u64..);
                order.extend(cells.map(|(&distance, cell)| Reverse(u64::from(distance) << 32 | cell)));
                nearest_cells = BinaryHeap::from(order);
                let mut compared = 0;
                while compared < self.words_compared as usize
                    && let Some(Reverse(nearest)) = nearest_cells.pop()
                {
                    let cell = nearest as u32 as usize;
                    visitors[cell].push(row);
                    compared += self.words[cell].len();
                }
                row += 1;
            }
        }
        visitors
    }

    /// All words in the order of their numbers.
    pub(super) fn word_rows(&self) -> Vec<u8> {
        self.words.iter().flat_map(Centres::rows).collect()
    }

    /// Cells are visited until a descriptor was compared with this many words.
    pub(super) fn words_compared(&self) -> u32 {
        self.words_compared
    }

    /// Cells, then the words of each.
    pub(super) fn encode(&self, writer: &mut Writer) {
        self.cells.encode(writer);
        for words in &self.words {
            words.encode(writer);
        }
    }

    /// Reads what [`SearchTree::encode`] wrote.
    pub(super) fn decode(
        kind: DescriptorKind,
        width: usize,
        words_compared: u32,
        reader: &mut Reader<'_>,
    ) -> Result<Self, DecodeError> {
        let cells = Centres::decode(kind, width, reader)?;
        let mut len = 0;
        let mut words = Vec::with_capacity(cells.len());
        for _ in 0..cells.len() {
            let of_cell = Centres::decode(kind, width, reader)?;
            len += of_cell.len();
            words.push(of_cell);
        }
        WordId::try_from(len).map_err(|_| DecodeError::invalid(format_args!("{len} words")))?;
        Ok(Self::new(cells, words, words_compared))
    }
}

/// How many of the words each cell gets: one, and of the rest a share in proportion to its distinct
/// rows (largest remainders, the first cell among equals). With n rows in all, a cell of n_c rows
/// gets at most n_c words, since W ≤ n.
fn shares(members: &[Vec<usize>], rows: usize, words: usize) -> Vec<usize> {
    let cells = members.len();
    let (spare_words, spare_rows) = ((words - cells) as u128, ((rows - cells) as u128).max(1));
    let claims = || members.iter().map(|members| spare_words * (members.len() - 1) as u128);
    let mut shares: Vec<usize> = claims().map(|claim| 1 + (claim / spare_rows) as usize).collect();
    let mut remainders: Vec<(Reverse<u128>, usize)> =
        claims().map(|claim| Reverse(claim % spare_rows)).zip(0..).collect();
    remainders.sort_unstable();
    let left = words - shares.iter().sum::<usize>();
    for (_, cell) in &remainders[..left] {
        shares[*cell] += 1;
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shares_add_up_and_no_cell_gets_more_words_than_rows(
            sizes in proptest::collection::vec(prop_oneof![1..5usize, 1..500usize], 1..60), part in 0.0..=1.0f64,
        ) {
            let members: Vec<Vec<usize>> = sizes.iter().map(|&size| vec![0; size]).collect();
            let rows: usize = sizes.iter().sum();
            let words = sizes.len() + ((rows - sizes.len()) as f64 * part) as usize;
            let shares = shares(&members, rows, words);
            prop_assert_eq!(shares.iter().sum::<usize>(), words);
            prop_assert!(shares.iter().zip(&sizes).all(|(share, size)| (1..=*size).contains(share)));
        }
    }
}
