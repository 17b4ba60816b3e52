//! Where k-means begins: greedy k-means++ (Arthur & Vassilvitskii, SODA 2007) on a random
//! subsample.

use super::progress::{Cancelled, Step};
use super::training_set::TrainingSet;
use crate::descriptor::lower_distances;
use rand::{Rng, RngExt};
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Rows of the subsample for each seed: enough that every cluster of typical size is represented,
/// few enough that seeding costs no more than a few iterations.
const SAMPLE_ROWS_PER_SEED: usize = 4;

/// Rows whose distances one task updates.
const CHUNK_ROWS: usize = 1024;

/// Seeds between two calls of the observer.
const SEEDS_PER_STEP: usize = 64;

/// Rows drawn for each seed, of which the best is taken: with one alone, some groups of descriptors
/// would get no seed and others two, which iterations cannot mend.
const CANDIDATES: usize = 3;

/// `count` distinct rows of the set, one after the other. Candidates are drawn with a probability
/// proportional to their squared distance from the nearest seed before them, and the one that
/// leaves the smallest sum of such distances is taken. (The Hamming distance is the squared
/// Euclidean distance of bits.) The set has at least `count` rows.
///
/// All sums are integers, so neither their order nor the number of threads matters.
pub(super) fn seeds(
    set: &TrainingSet<'_>,
    count: usize,
    random: &mut impl Rng,
    observer: &mut dyn FnMut(Step) -> ControlFlow<()>,
) -> Result<Vec<u8>, Cancelled> {
    let sample = Sample::draw(set, count, random);
    let first = random_weighted(&sample.set.weights, random);
    let mut best = Nearness { distances: vec![u32::MAX; sample.set.len()], masses: Vec::new() };
    let mut trial = best.clone();
    let mut nearest = best.clone();
    sample.seeded(&best.distances, first, &mut nearest);

    let mut seeds = sample.set.rows[first].to_vec();
    for seeded in 1..count {
        if seeded.is_multiple_of(SEEDS_PER_STEP) {
            Cancelled::unless_continued(observer(Step::Seeding { fraction: seeded as f64 / count as f64 }))?;
        }
        let mut taken = None;
        for _ in 0..CANDIDATES {
            let candidate = sample.random_far_row(&nearest, random);
            sample.seeded(&nearest.distances, candidate, &mut trial);
            if taken.is_none() || trial.mass() < best.mass() {
                taken = Some(candidate);
                std::mem::swap(&mut trial, &mut best);
            }
        }
        seeds.extend(taken.iter().flat_map(|&row| sample.set.rows[row]));
        std::mem::swap(&mut nearest, &mut best);
    }
    Ok(seeds)
}

/// The subsample, and its rows side by side.
struct Sample<'a> {
    set: TrainingSet<'a>,
    rows: Vec<u8>,
}

/// How near the rows of the sample are to the seeds.
#[derive(Clone)]
struct Nearness {
    /// Distance of each row from its nearest seed.
    distances: Vec<u32>,
    /// Their sums, weighted, over chunks of rows.
    masses: Vec<u64>,
}

impl Nearness {
    fn mass(&self) -> u64 {
        self.masses.iter().sum()
    }
}

impl<'a> Sample<'a> {
    fn draw(set: &TrainingSet<'a>, seeds: usize, random: &mut impl Rng) -> Self {
        let set = subsample(set, seeds.saturating_mul(SAMPLE_ROWS_PER_SEED), random);
        let rows = set.rows.concat();
        Self { set, rows }
    }

    /// What `distances` become when row `seed` is a seed too.
    fn seeded(&self, distances: &[u32], seed: usize, nearness: &mut Nearness) {
        nearness
            .distances
            .par_chunks_mut(CHUNK_ROWS)
            .zip(distances.par_chunks(CHUNK_ROWS))
            .zip(self.rows.par_chunks(CHUNK_ROWS * self.set.width))
            .zip(self.set.weights.par_chunks(CHUNK_ROWS))
            .map(|(((lowered, distances), rows), weights)| {
                lowered.copy_from_slice(distances);
                lower_distances(self.set.kind, self.set.rows[seed], rows, lowered);
                lowered.iter().zip(weights).map(|(&distance, weight)| u64::from(distance) * weight).sum()
            })
            .collect_into_vec(&mut nearness.masses);
    }

    /// A row drawn with a probability proportional to its distance: first its chunk, then the row.
    fn random_far_row(&self, nearness: &Nearness, random: &mut impl Rng) -> usize {
        let start = random_weighted(&nearness.masses, random) * CHUNK_ROWS;
        let end = (start + CHUNK_ROWS).min(self.set.len());
        let masses: Vec<u64> =
            (start..end).map(|row| u64::from(nearness.distances[row]) * self.set.weights[row]).collect();
        start + random_weighted(&masses, random)
    }
}

/// `count` rows of the set, any as likely as any other (selection sampling, Knuth), in their order;
/// the whole set if it has no more.
fn subsample<'a>(set: &TrainingSet<'a>, count: usize, random: &mut impl Rng) -> TrainingSet<'a> {
    let mut wanted = count.min(set.len());
    let members: Vec<usize> = (0..set.len())
        .filter(|row| {
            let taken = random.random_range(0..set.len() - row) < wanted;
            wanted -= usize::from(taken);
            taken
        })
        .collect();
    set.subset(&members)
}

/// An index drawn with probability proportional to its weight; their sum is above 0.
fn random_weighted(weights: &[u64], random: &mut impl Rng) -> usize {
    let mut left = random.random_range(0..weights.iter().sum::<u64>());
    for (index, &weight) in weights.iter().enumerate() {
        if left < weight {
            return index;
        }
        left -= weight;
    }
    unreachable!("a number below the sum of all weights lies within one of them")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::descriptor::{DescriptorKind, Descriptors};
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    proptest! {
        #[test]
        fn seeds_are_distinct_rows_of_the_set(
            bytes in proptest::collection::vec(0..12u8, 3..900), count in 1..40usize, seed in any::<u64>(),
        ) {
            let bytes = bytes[..bytes.len() / 3 * 3].to_vec();
            let descriptors = Descriptors::new(DescriptorKind::Float, 3, bytes).unwrap();
            let set = TrainingSet::new(&descriptors);
            let count = count.min(set.len());
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let seeds = seeds(&set, count, &mut random, &mut |_| ControlFlow::Continue(())).unwrap();
            let mut seeds: Vec<&[u8]> = seeds.chunks_exact(3).collect();
            prop_assert!(seeds.iter().all(|seed| set.rows.contains(seed)));
            seeds.sort_unstable();
            prop_assert!(seeds.is_sorted_by(|a, b| a < b));
            prop_assert_eq!(seeds.len(), count);
        }
    }

    #[test]
    fn far_rows_are_drawn_before_near_ones() {
        // Two tight groups: after a seed in one, nearly all probability lies on the other.
        let bytes = (0..200u8).map(|row| if row % 2 == 0 { row / 50 } else { 250 + row / 50 }).collect();
        let descriptors = Descriptors::new(DescriptorKind::Float, 1, bytes).unwrap();
        let set = TrainingSet::new(&descriptors);
        for seed in 0..50 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let seeds = seeds(&set, 2, &mut random, &mut |_| ControlFlow::Continue(())).unwrap();
            assert!(seeds[0].abs_diff(seeds[1]) > 200, "{seeds:?}");
        }
    }
}
