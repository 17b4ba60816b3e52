//! Motion in the image plane: x' = s R x + t, as the complex x' = f x + t.

use nalgebra::Complex;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use topomap::evidence::Similarity;

use super::correspondence::{Correspondence, total, weight};

/// How far a match may lie from where the motion puts it, in image widths. Wide, because a camera
/// that comes back a step further on sees near things shifted against far ones.
const TOLERANCE_WIDTHS: f64 = 0.04;

/// Pairs of matches that are tried. With a tenth of the matches right, one of 458 is of two right
/// ones with a chance of 99%.
const DRAWS: usize = 500;

/// Points nearer to each other than this say nothing of scale and rotation, in image widths.
const MIN_BASE_WIDTHS: f64 = 0.02;

/// Refits to the inliers at most; it ends when they stay the same.
const MAX_REFITS: usize = 5;

/// s e^{iφ}, and t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlaneMotion {
    factor: Complex<f64>,
    shift: Complex<f64>,
}

/// The motion that most matches, by weight, agree with; `None` of fewer than two.
pub(super) fn estimate(
    pairs: &[Correspondence],
    random: &mut ChaCha8Rng,
) -> Option<(Similarity, Vec<Correspondence>)> {
    let mut motion = most_agreed(pairs, random)?;
    let mut inliers = motion.inliers(pairs);
    for _ in 0..MAX_REFITS {
        let Some(refitted) = PlaneMotion::fit(&inliers) else { break };
        let refitted_inliers = refitted.inliers(pairs);
        if total(&refitted_inliers) < total(&inliers) {
            break;
        }
        let settled = refitted_inliers == inliers;
        (motion, inliers) = (refitted, refitted_inliers);
        if settled {
            break;
        }
    }
    Some((motion.as_similarity(), inliers))
}

fn most_agreed(pairs: &[Correspondence], random: &mut ChaCha8Rng) -> Option<PlaneMotion> {
    if pairs.len() < 2 {
        return None;
    }
    let mut best: Option<(u32, PlaneMotion)> = None;
    for _ in 0..DRAWS {
        let first = random.random_range(0..pairs.len());
        let second = (first + random.random_range(1..pairs.len())) % pairs.len();
        let Some(motion) = PlaneMotion::of_two(&pairs[first], &pairs[second]) else { continue };
        let limit = motion.limit();
        let agreeing = pairs.iter().filter(|pair| motion.agrees(pair, limit)).map(weight).sum();
        if best.is_none_or(|(most, _)| agreeing > most) {
            best = Some((agreeing, motion));
        }
    }
    best.map(|(_, motion)| motion)
}

impl PlaneMotion {
    fn of_two(a: &Correspondence, b: &Correspondence) -> Option<Self> {
        let (from, to) = (b.earlier - a.earlier, b.current - a.current);
        if from.norm() < MIN_BASE_WIDTHS || to.norm() < MIN_BASE_WIDTHS {
            return None;
        }
        let factor = to / from;
        Some(Self { factor, shift: a.current - factor * a.earlier })
    }

    /// Least squares, with the scale that is the inverse of that of swapped views: Horn, JOSA A
    /// 4(4) 1987, section 2.D.
    pub(super) fn fit(pairs: &[Correspondence]) -> Option<Self> {
        let mean = |of: fn(&Correspondence) -> Complex<f64>| {
            pairs.iter().map(of).sum::<Complex<f64>>() / pairs.len() as f64
        };
        let (earlier, current) = (mean(|pair| pair.earlier), mean(|pair| pair.current));
        let mut cross = Complex::new(0.0, 0.0);
        let mut earlier_spread = 0.0;
        let mut current_spread = 0.0;
        for pair in pairs {
            let (from, to) = (pair.earlier - earlier, pair.current - current);
            cross += from.conj() * to;
            earlier_spread += from.norm_sqr();
            current_spread += to.norm_sqr();
        }
        let factor = cross / cross.norm() * (current_spread / earlier_spread).sqrt();
        let motion = Self { factor, shift: current - factor * earlier };
        (motion.factor.is_finite() && motion.factor.norm() > 0.0).then_some(motion)
    }

    /// Square of the distance in the current image up to which a pair agrees; that of both images,
    /// by its geometric mean: swapped views agree on it.
    fn limit(&self) -> f64 {
        TOLERANCE_WIDTHS.powi(2) * self.factor.norm()
    }

    fn agrees(&self, pair: &Correspondence, limit: f64) -> bool {
        let distance = pair.current - self.factor * pair.earlier - self.shift;
        distance.norm_sqr() <= limit
    }

    fn inliers(&self, pairs: &[Correspondence]) -> Vec<Correspondence> {
        let limit = self.limit();
        pairs.iter().filter(|pair| self.agrees(pair, limit)).copied().collect()
    }

    pub(super) fn as_similarity(&self) -> Similarity {
        Similarity {
            rotation_rad: self.factor.arg(),
            ln_scale: self.factor.norm().ln(),
            translation_widths: [self.shift.re, self.shift.im],
        }
    }
}
