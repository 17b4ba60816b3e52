//! Lloyd's algorithm (1982) in integers: k-means for float descriptors, k-majority for binary ones.
//!
//! Rows are assigned to their nearest centre, and each centre moves to where the sum of distances
//! to its rows is least: with squared Euclidean distances the mean, with Hamming distances the
//! majority of each bit (Grana, Borghesani, Manfredi & Cucchiara 2013, for ORB).

use super::progress::{Cancelled, Step};
use super::seeding;
use super::training_set::TrainingSet;
use crate::descriptor::DescriptorKind;
use crate::quantizer::{BLOCK_ROWS, Centres, Nearest};
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
mod tests;
