//! How a robot on a floor has moved between two views all around: the motion that most matched rays
//! agree with.
//!
//! Rays are of length 1, in axes x forward, y left, z up. A point X seen from the target lies at R
//! (X - t) for the robot that sees now, so that x1ᵀ E x2 = 0 with E = R \[t\]ₓ, x1 now and x2 at
//! the target. The way to drive is d = -R t.
//!
//! The motion is searched by RANSAC (Fischler & Bolles, CACM 1981): planar motion by the linear
//! four-point algorithm (Booij, Terwijn, Zivkovic & Kröse, ICRA 2007). The same rays, settings and
//! seed give the same answer; tests compare it with the eight-point algorithm for any motion.

#[cfg(test)]
mod general;
mod planar;
mod reprojection;
mod turning;

use nalgebra::{Rotation3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub use planar::PlanarMotion;
pub use reprojection::{Reprojection, reprojection};
pub use turning::{Turn, turn};

/// One thing as it is seen from two places: rays of length 1, x forward, y left, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayPair {
    /// x1, from where the robot is now.
    pub current: Vector3<f64>,
    /// x2, from where it wants to go.
    pub target: Vector3<f64>,
}

/// How a motion is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchSettings {
    /// Largest reprojection error of a pair that agrees, in radians, above 0.
    pub tolerance_rad: f64,
    /// Samples that are drawn at most.
    pub max_draws: usize,
    /// Of the draws.
    pub seed: u64,
}

impl Default for SearchSettings {
    fn default() -> Self {
        // Two pixels of 1024 all around.
        Self { tolerance_rad: 0.012, max_draws: 300, seed: 0 }
    }
}

/// A motion between two views, of which the length of the way is not known.
pub trait Motion: Copy {
    /// Pairs that fix it.
    const SAMPLE: usize;

    /// R: takes directions of the target's axes to the current ones.
    fn rotation(&self) -> Rotation3<f64>;

    /// d / |d|: where the target is, in current axes.
    fn direction(&self) -> Unit<Vector3<f64>>;

    /// The motion that at least [`Motion::SAMPLE`] pairs agree with best in a linear sense: of
    /// those that share its essential matrix, the one that puts most pairs before both cameras.
    /// `None` if the pairs leave it open.
    fn fit(pairs: &[RayPair]) -> Option<Self>;

    /// The same motion, moved to where the pairs' reprojection errors are least to first order.
    #[must_use]
    fn refined(self, pairs: &[RayPair]) -> Self;

    /// How far a pair is from one that this motion explains.
    fn reprojection(&self, pair: &RayPair) -> Reprojection {
        reprojection(&self.rotation(), &self.direction(), pair)
    }
}

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Consensus<M> {
    /// Refitted to all pairs that agree with it.
    pub motion: M,
    /// Which ones those are: low reprojection error, before both cameras.
    pub inliers: Vec<usize>,
}

/// Refits to the pairs that agree.
const REFITS: usize = 3;

/// Chance that all samples so far had a wrong pair, at which no more are drawn.
const MISSED: f64 = 1e-3;

/// The motion that most pairs agree with. `None` if there are fewer than a sample of them, or no
/// sample puts all its points before both cameras.
#[must_use]
pub fn search<M: Motion>(pairs: &[RayPair], settings: &SearchSettings) -> Option<Consensus<M>> {
    let sampled = most_agreed::<M>(pairs, settings)?;
    let mut best = sampled;
    for _ in 0..REFITS {
        let support: Vec<RayPair> = best.inliers.iter().map(|&index| pairs[index]).collect();
        let Some(motion) = M::fit(&support).map(|motion| motion.refined(&support)) else { break };
        let refitted = agreeing(motion, pairs, settings.tolerance_rad);
        if refitted.inliers.len() < best.inliers.len() {
            break;
        }
        let is_settled = refitted.inliers == best.inliers;
        best = refitted;
        if is_settled {
            break;
        }
    }
    Some(best)
}

fn most_agreed<M: Motion>(pairs: &[RayPair], settings: &SearchSettings) -> Option<Consensus<M>> {
    if pairs.len() < M::SAMPLE {
        return None;
    }
    let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut best: Option<Consensus<M>> = None;
    let mut drawn = 0;
    let mut draws = settings.max_draws;
    while drawn < draws {
        drawn += 1;
        let sample = drawn_pairs(pairs, M::SAMPLE, &mut random);
        let Some(motion) = M::fit(&sample) else { continue };
        let is_before_both = |pair: &RayPair| motion.reprojection(pair).behind_rad <= settings.tolerance_rad;
        if !sample.iter().all(is_before_both) {
            continue;
        }
        let found = agreeing(motion, pairs, settings.tolerance_rad);
        if found.inliers.len() >= M::SAMPLE
            && best.as_ref().is_none_or(|best| found.inliers.len() > best.inliers.len())
        {
            let right = found.inliers.len() as f64 / pairs.len() as f64;
            draws = draws_needed(right, M::SAMPLE).min(settings.max_draws);
            best = Some(found);
        }
    }
    best
}

fn agreeing<M: Motion>(motion: M, pairs: &[RayPair], tolerance_rad: f64) -> Consensus<M> {
    let agrees = |&(_, pair): &(usize, &RayPair)| motion.reprojection(pair).error_rad <= tolerance_rad;
    let inliers = pairs.iter().enumerate().filter(agrees).map(|(index, _)| index).collect();
    Consensus { motion, inliers }
}

fn draws_needed(right: f64, sample: usize) -> usize {
    (MISSED.ln() / (-right.powi(sample as i32)).ln_1p()).ceil() as usize
}

fn drawn_pairs(pairs: &[RayPair], count: usize, random: &mut ChaCha8Rng) -> Vec<RayPair> {
    let mut chosen: Vec<usize> = Vec::with_capacity(count);
    while chosen.len() < count {
        let index = random.random_range(0..pairs.len());
        if !chosen.contains(&index) {
            chosen.push(index);
        }
    }
    chosen.into_iter().map(|index| pairs[index]).collect()
}

/// By how much the pairs part instead of meeting before both cameras: what tells a way from the way
/// back.
fn behind_both_rad<M: Motion>(motion: &M, pairs: &[RayPair]) -> f64 {
    pairs.iter().map(|pair| motion.reprojection(pair).behind_rad.min(0.1)).sum()
}

#[cfg(test)]
mod tests;
