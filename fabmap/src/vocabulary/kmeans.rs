//! Lloyd's algorithm in integers: k-means for float descriptors, k-majority for binary ones.

use super::centres::{BLOCK_ROWS, Centres, Nearest};
use super::seeding;
use super::training_set::TrainingSet;
use crate::descriptor::DescriptorKind;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::ops::ControlFlow;

/// Rows assigned between two calls of the observer.
const ROWS_PER_STEP: usize = 256 * BLOCK_ROWS;

/// A training set divided into clusters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Clusters {
    /// Centres as consecutive rows, all different.
    pub(super) centres: Vec<u8>,
    /// Cluster of each row of the set; no cluster is empty.
    pub(super) assigned: Vec<Nearest>,
    /// Sum of the distances of all descriptors from their centres.
    pub(super) inertia: u64,
}

/// How far clustering has come.
#[derive(Clone, Copy, Debug)]
pub(super) enum Step {
    /// Choosing the first centres.
    Seeding { fraction: f64 },
    /// Assigning rows; iteration 0 assigns to the first centres.
    Iteration { iteration: u32, fraction: f64 },
}

/// The observer asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cancelled;

impl Cancelled {
    pub(super) fn unless_continued(answer: ControlFlow<()>) -> Result<(), Self> {
        match answer {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Self),
        }
    }
}

/// Divides the set into `count` clusters, 1 to its number of rows.
///
/// A mean rounded to nearest is the best centre among those that bytes can hold, and so is the
/// majority of each bit: the inertia never rises, and when it no longer falls, the clusters are
/// final.
pub(super) fn cluster(
    set: &TrainingSet<'_>,
    count: usize,
    iterations: u32,
    random: &mut ChaCha8Rng,
    observer: &mut dyn FnMut(Step) -> ControlFlow<()>,
) -> Result<Clusters, Cancelled> {
    let seeds = seeding::seeds(set, count, random, observer)?;
    let mut clusters = assign(set, seeds, 0, observer)?;
    for iteration in 1..=iterations {
        let next = assign(set, clusters.best_centres(set), iteration, observer)?;
        if next.inertia >= clusters.inertia {
            break;
        }
        clusters = next;
    }
    Ok(clusters)
}

/// Assigns each row to its nearest centre, then fills clusters that got none.
fn assign(
    set: &TrainingSet<'_>,
    centres: Vec<u8>,
    iteration: u32,
    observer: &mut dyn FnMut(Step) -> ControlFlow<()>,
) -> Result<Clusters, Cancelled> {
    let packed = Centres::pack(set.kind, set.width, &centres);
    let mut assigned = vec![Nearest::default(); set.len()];
    for (step, (assigned, rows)) in
        assigned.chunks_mut(ROWS_PER_STEP).zip(set.rows.chunks(ROWS_PER_STEP)).enumerate()
    {
        let fraction = (step * ROWS_PER_STEP) as f64 / set.len() as f64;
        Cancelled::unless_continued(observer(Step::Iteration { iteration, fraction }))?;
        assigned
            .par_chunks_mut(BLOCK_ROWS)
            .zip(rows.par_chunks(BLOCK_ROWS))
            .for_each(|(assigned, rows)| packed.nearest(&rows.concat(), assigned));
    }
    let mut clusters = Clusters { centres, assigned, inertia: 0 };
    clusters.fill_empty(set);
    clusters.inertia = clusters
        .assigned
        .iter()
        .zip(&set.weights)
        .map(|(nearest, weight)| u64::from(nearest.distance) * weight)
        .sum();
    Ok(clusters)
}

impl Clusters {
    /// The rows of each cluster, ascending.
    pub(super) fn members(&self, width: usize) -> Vec<Vec<usize>> {
        let mut members = vec![Vec::new(); self.centres.len() / width];
        for (row, nearest) in self.assigned.iter().enumerate() {
            members[nearest.id as usize].push(row);
        }
        members
    }

    /// Gives each empty cluster the row farthest from its centre, as its centre and only member;
    /// among equals the first row. Rows alone in their cluster stay there.
    ///
    /// There are enough such rows: the rows of a cluster differ, so all but one of them lie away
    /// from its centre. Two equal centres mend themselves here: the second one is empty.
    fn fill_empty(&mut self, set: &TrainingSet<'_>) {
        let mut members: Vec<usize> = self.members(set.width).iter().map(Vec::len).collect();
        let empty: Vec<usize> = (0..members.len()).filter(|&cluster| members[cluster] == 0).collect();
        if empty.is_empty() {
            return;
        }
        let mut farthest: Vec<usize> = (0..set.len()).collect();
        farthest.sort_unstable_by_key(|&row| (Reverse(self.assigned[row].distance), row));
        let mut farthest = farthest.into_iter();
        for cluster in empty {
            for row in farthest.by_ref() {
                let nearest = &mut self.assigned[row];
                if members[nearest.id as usize] > 1 {
                    members[nearest.id as usize] -= 1;
                    *nearest = Nearest { id: cluster as u32, distance: 0 };
                    self.centres[cluster * set.width..(cluster + 1) * set.width]
                        .copy_from_slice(set.rows[row]);
                    break;
                }
            }
        }
    }

    /// The best centre of each cluster: the rounded mean, or the majority of each bit.
    ///
    /// Sums are integers, for which addition is associative: how rows are shared out among threads
    /// cannot change a centre.
    fn best_centres(&self, set: &TrainingSet<'_>) -> Vec<u8> {
        let mut centres = self.centres.clone();
        let members = self.members(set.width);
        centres.par_chunks_mut(set.width).zip(members).for_each(|(centre, members)| {
            let rows = members.iter().map(|&row| (set.rows[row], set.weights[row]));
            let total: u64 = members.iter().map(|&row| set.weights[row]).sum();
            match set.kind {
                DescriptorKind::Float => move_to_mean(centre, rows, total),
                DescriptorKind::Binary => move_to_majority(centre, rows, total),
            }
        });
        centres
    }
}

/// Σ w x / Σ w in each dimension, rounded to nearest, halves up.
fn move_to_mean<'a>(centre: &mut [u8], rows: impl Iterator<Item = (&'a [u8], u64)>, total: u64) {
    let mut sums = vec![0u64; centre.len()];
    for (row, weight) in rows {
        for (sum, &value) in sums.iter_mut().zip(row) {
            *sum += u64::from(value) * weight;
        }
    }
    for (value, sum) in centre.iter_mut().zip(sums) {
        *value = ((sum + total / 2) / total) as u8;
    }
}

/// Each bit as most rows have it; a tie keeps the bit as it was.
fn move_to_majority<'a>(centre: &mut [u8], rows: impl Iterator<Item = (&'a [u8], u64)>, total: u64) {
    let mut set_counts = vec![[0u64; 8]; centre.len()];
    for (row, weight) in rows {
        for (counts, &byte) in set_counts.iter_mut().zip(row) {
            for (bit, count) in counts.iter_mut().enumerate() {
                *count += u64::from(byte >> bit & 1) * weight;
            }
        }
    }
    for (byte, counts) in centre.iter_mut().zip(set_counts) {
        for (bit, count) in counts.into_iter().enumerate() {
            match (2 * count).cmp(&total) {
                std::cmp::Ordering::Less => *byte &= !(1 << bit),
                std::cmp::Ordering::Equal => {}
                std::cmp::Ordering::Greater => *byte |= 1 << bit,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::descriptor::Descriptors;
    use proptest::prelude::*;
    use rand::SeedableRng;

    const KINDS: [DescriptorKind; 2] = [DescriptorKind::Float, DescriptorKind::Binary];

    fn run(set: &TrainingSet<'_>, count: usize, iterations: u32, seed: u64) -> Clusters {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        cluster(set, count, iterations, &mut random, &mut |_| ControlFlow::Continue(())).unwrap()
    }

    proptest! {
        #[test]
        fn inertia_never_rises_and_clusters_are_whole(
            bytes in proptest::collection::vec(prop_oneof![any::<u8>(), 0..3u8], 4..1200),
            count in 1..60usize, seed in any::<u64>(),
        ) {
            for kind in KINDS {
                let descriptors = Descriptors::new(kind, 4, bytes[..bytes.len() / 4 * 4].to_vec()).unwrap();
                let set = TrainingSet::new(&descriptors);
                let count = count.min(set.len());
                let mut inertia = u64::MAX;
                for iterations in [0, 1, 2, 3, 30] {
                    let clusters = run(&set, count, iterations, seed);
                    prop_assert!(clusters.inertia <= inertia);
                    inertia = clusters.inertia;

                    prop_assert!(clusters.members(4).iter().all(|members| !members.is_empty()));
                    let mut centres: Vec<&[u8]> = clusters.centres.chunks_exact(4).collect();
                    centres.sort_unstable();
                    prop_assert!(centres.is_sorted_by(|a, b| a < b), "two equal centres");
                    for (row, nearest) in set.rows.iter().zip(&clusters.assigned) {
                        let centre = clusters.centres.chunks_exact(4).nth(nearest.id as usize).unwrap();
                        prop_assert_eq!(kind.distance(row, centre), nearest.distance);
                    }
                }
            }
        }

        #[test]
        fn no_centre_is_better_than_the_mean_or_the_majority(
            bytes in proptest::collection::vec(any::<u8>(), 1..40), other in any::<u8>(), old in any::<u8>(),
        ) {
            for kind in KINDS {
                let mut centre = [old];
                let rows = bytes.chunks(1).map(|row| (row, 3));
                match kind {
                    DescriptorKind::Float => move_to_mean(&mut centre, rows, 3 * bytes.len() as u64),
                    DescriptorKind::Binary => move_to_majority(&mut centre, rows, 3 * bytes.len() as u64),
                }
                let inertia = |centre: u8| bytes.iter().map(|&row| kind.distance(&[row], &[centre])).sum::<u32>();
                prop_assert!(inertia(centre[0]) <= inertia(other));
            }
        }
    }

    #[test]
    fn halves_round_up_and_tied_bits_stay() {
        let mut mean = [0, 0];
        move_to_mean(&mut mean, [(&[1u8, 7][..], 1), (&[2, 7][..], 1)].into_iter(), 2);
        assert_eq!(mean, [2, 7]);
        let mut majority = [0b1010];
        move_to_majority(&mut majority, [(&[0b1100u8][..], 1), (&[0b0101][..], 1)].into_iter(), 2);
        assert_eq!(majority, [0b1100]);
    }

    #[test]
    fn repeated_rows_count_as_often_as_they_occur() {
        let descriptors = Descriptors::new(DescriptorKind::Float, 1, vec![10, 10, 10, 20]).unwrap();
        let set = TrainingSet::new(&descriptors);
        assert_eq!((set.len(), set.weights.as_slice()), (2, &[3, 1][..]));
        let clusters = run(&set, 1, 5, 0);
        assert_eq!((clusters.centres, clusters.inertia), (vec![13], 3 * 9 + 49));
    }

    #[test]
    fn an_empty_cluster_takes_the_farthest_row() {
        let descriptors = Descriptors::new(DescriptorKind::Float, 1, vec![0, 1, 9, 100, 104]).unwrap();
        let set = TrainingSet::new(&descriptors);
        let clusters = assign(&set, vec![2, 2, 200], 0, &mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(clusters.centres, [2, 100, 200]);
        let ids: Vec<u32> = clusters.assigned.iter().map(|nearest| nearest.id).collect();
        assert_eq!(ids, [0, 0, 0, 1, 2]);
    }
}
