//! A vocabulary too large to compare with every word: words in cells, searched best cell first.

use super::centres::{BLOCK_ROWS, Centres};
use super::nearest::Nearest;
use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::DescriptorKind;
use crate::observation::WordId;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// [`SearchTree::words_compared`] of trees of the first stored form, which does not say it: what
/// they were made to be searched with remains, for a map's words must not change.
pub(crate) const FIRST_FORM_WORDS_COMPARED: u32 = 8192;

/// Most rows looked up together: enough that hundreds of them meet in a cell.
pub(crate) const TREE_BLOCK_ROWS: usize = 4096;

/// A tree of two levels: about √W cells, found by k-means over all descriptors, and in each cell
/// its words, found by k-means over the cell's descriptors.
///
/// A descriptor's nearest word often lies across the border of its nearest cell, so more cells are
/// searched, best first. What is found is the nearest word of the cells visited.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SearchTree {
    cells: Centres,
    /// Words of each cell. Words are numbered through all cells in order.
    words: Vec<Centres>,
    /// Number of the first word of each cell.
    first_words: Vec<u32>,
    /// Cells are visited until a descriptor was compared with this many words.
    words_compared: u32,
}

impl SearchTree {
    /// A tree of these cells, each with its words.
    pub(crate) fn new(cells: Centres, words: Vec<Centres>, words_compared: u32) -> Self {
        let mut next = 0;
        let first_words = words
            .iter()
            .map(|words| {
                let first = next;
                next += words.len() as u32;
                first
            })
            .collect();
        Self { cells, words, first_words, words_compared }
    }

    pub(crate) fn len(&self) -> usize {
        self.words.iter().map(Centres::len).sum()
    }

    /// For each of consecutive rows the nearest word of the cells it visits, the lowest number
    /// among equals.
    ///
    /// Which cells those are is settled first; then each cell is compared with all its visitors
    /// together, so that its words come from memory once.
    pub(crate) fn words(&self, width: usize, rows: &[u8], words: &mut [WordId]) {
        let mut best = vec![(u32::MAX, WordId::MAX); words.len()];
        let mut visiting = Vec::new();
        let mut nearest = Vec::new();
        for (cell, visitors) in self.visitors(width, rows).iter().enumerate() {
            visiting.clear();
            for &row in visitors {
                visiting.extend_from_slice(&rows[row * width..(row + 1) * width]);
            }
            nearest.resize(visitors.len(), Nearest::default());
            self.words[cell].nearest(&visiting, &mut nearest);
            for (&row, nearest) in visitors.iter().zip(&nearest) {
                best[row] =
                    best[row].min((nearest.distance, WordId::new(self.first_words[cell] + nearest.id)));
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
    pub(crate) fn word_rows(&self) -> Vec<u8> {
        self.words.iter().flat_map(Centres::rows).collect()
    }

    /// Cells are visited until a descriptor was compared with this many words.
    pub(crate) fn words_compared(&self) -> u32 {
        self.words_compared
    }

    /// Cells, then the words of each.
    pub(crate) fn encode(&self, writer: &mut Writer) {
        self.cells.encode(writer);
        for words in &self.words {
            words.encode(writer);
        }
    }

    /// Reads what [`SearchTree::encode`] wrote.
    pub(crate) fn decode(
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
        u32::try_from(len).map_err(|_| DecodeError::invalid(format_args!("{len} words")))?;
        Ok(Self::new(cells, words, words_compared))
    }
}
