//! Training a vocabulary too large to compare with every word: cells, then the words of each.

use super::kmeans::{self, Clusters};
use super::progress::{Cancelled, TreeStep};
use super::training_set::TrainingSet;
use crate::quantizer::{Centres, SearchTree};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::ops::ControlFlow;

/// Cells are visited, nearest first, until a descriptor was compared with this many words. On SIFT
/// descriptors of images not trained on, by which the number was chosen, 99% get the nearest of
/// 100,000 words then.
const WORDS_COMPARED: u32 = 2048;

/// Cells trained between two calls of the observer. Threads that find no cell help with the rows of
/// another's.
const CELLS_PER_STEP: usize = 4;

/// Trains a tree of exactly `words` words, at most as many as the set has rows.
pub(super) fn train(
    set: &TrainingSet<'_>,
    words: usize,
    iterations: u32,
    seed: u64,
    observer: &mut dyn FnMut(TreeStep) -> ControlFlow<()>,
) -> Result<SearchTree, Cancelled> {
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
        let trained = centres.len() as u32;
        let cells = cells.centres.len() / set.width;
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
    Ok(SearchTree::new(Centres::pack(set.kind, set.width, &cells.centres), centres, WORDS_COMPARED))
}

/// How many of the words each cell gets: one, and of the rest a share in proportion to its distinct
/// rows (largest remainders, the first cell among equals). With n rows in all, a cell of n_c rows
/// gets at most n_c words, since W ≤ n.
fn shares(members: &[Vec<usize>], rows: usize, words: usize) -> Vec<usize> {
    let cells = members.len();
    let spare_words = (words - cells) as u128;
    let spare_rows = ((rows - cells) as u128).max(1);
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
