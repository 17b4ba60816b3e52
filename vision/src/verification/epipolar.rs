//! ViewMotion in space: current views of a point lie on a line that its earlier view gives.
//! Hartley & Zisserman, Multiple View Geometry, chapters 9 and 11.

use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use topomap::evidence::ViewMotion;

use super::correspondence::{Correspondence, total, weight};
use super::epipolar_matrices::{
    SAMPLE, decompose, eight_point, essential_part, of_rank_two, sampson, seven_point,
};
use super::rigid_motion::RigidMotion;

/// How far a match may lie from its line, in image widths: two pixels of 640.
pub(super) const TOLERANCE_WIDTHS: f64 = 0.003;

/// Samples that are tried at most.
const MAX_DRAWS: usize = 1000;

/// Chance that all samples so far had a wrong match, at which no more are drawn.
const MISSED: f64 = 0.01;

/// Refits to the inliers at most.
const MAX_REFITS: usize = 3;

/// Makes the matrix what it must be by its meaning.
type Constraint = fn(Matrix3<f64>) -> Option<Matrix3<f64>>;

/// The fundamental matrix that most matches, by weight, agree with; coordinates in image widths.
pub(super) fn fundamental(
    pairs: &[Correspondence],
    random: &mut ChaCha8Rng,
) -> Option<(ViewMotion, Vec<Correspondence>)> {
    let (matrix, inliers) = estimate(pairs, TOLERANCE_WIDTHS, of_rank_two, random)?;
    let matrix = matrix.normalize();
    let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
    Some((ViewMotion::Fundamental(rows), inliers))
}

/// Rotation and direction that most matches, by weight, agree with; coordinates are those of rays,
/// divided by their depth. It begins at the essential matrix nearest to the matrix that most
/// matches agree with, which with keypoints half a pixel off loses up to two thirds of them, and is
/// then fitted within its own five degrees of freedom.
pub(super) fn essential(
    pairs: &[Correspondence],
    tolerance: f64,
    random: &mut ChaCha8Rng,
) -> Option<(ViewMotion, Vec<Correspondence>)> {
    let (matrix, mut inliers) = estimate(pairs, tolerance, essential_part, random)?;
    let (rotation, direction) = decompose(&matrix, &inliers)?;
    let mut motion = RigidMotion { rotation, direction };
    let refined = motion.refined(pairs, tolerance);
    let agreeing = agreeing(&refined.essential_matrix(), pairs, tolerance);
    if total(&agreeing) >= total(&inliers) {
        (motion, inliers) = (refined, agreeing);
    }
    let RigidMotion { rotation, direction } = motion;
    Some((ViewMotion::Essential { rotation, direction }, inliers))
}

fn estimate(
    pairs: &[Correspondence],
    tolerance: f64,
    constraint: Constraint,
    random: &mut ChaCha8Rng,
) -> Option<(Matrix3<f64>, Vec<Correspondence>)> {
    let inliers_of = |matrix: &Matrix3<f64>| agreeing(matrix, pairs, tolerance);
    let sampled = most_agreed(pairs, tolerance, random)?;
    let mut best = constraint(sampled).map(|matrix| (matrix, inliers_of(&matrix)));
    // Seven matches give an essential matrix only as exactly as they were seen; its part is taken
    // of all inliers.
    let mut support = inliers_of(&sampled);
    for _ in 0..MAX_REFITS {
        let Some(refitted) = eight_point(&support).and_then(constraint) else { break };
        let inliers = inliers_of(&refitted);
        let settled = inliers == support;
        support = inliers.clone();
        if best.as_ref().is_none_or(|(_, best)| total(&inliers) >= total(best)) {
            best = Some((refitted, inliers));
        }
        if settled {
            break;
        }
    }
    best
}

fn agreeing(matrix: &Matrix3<f64>, pairs: &[Correspondence], tolerance: f64) -> Vec<Correspondence> {
    pairs.iter().filter(|pair| sampson(matrix, pair).powi(2) <= tolerance * tolerance).copied().collect()
}

fn most_agreed(pairs: &[Correspondence], tolerance: f64, random: &mut ChaCha8Rng) -> Option<Matrix3<f64>> {
    if pairs.len() <= SAMPLE {
        return None;
    }
    let mut best: Option<(u32, Matrix3<f64>)> = None;
    let mut drawn = 0;
    let mut draws = MAX_DRAWS;
    // Seven matches of a view that has not moved at all leave open where it went; straight on
    // explains them.
    let mut matrices: Vec<Matrix3<f64>> = [0, 1, 2].map(|axis| Vector3::ith(axis, 1.0).cross_matrix()).into();
    while drawn < draws {
        drawn += 1;
        for matrix in matrices.drain(..) {
            let agreeing =
                pairs.iter().filter(|pair| sampson(&matrix, pair).powi(2) <= tolerance * tolerance);
            let (count, total) =
                agreeing.fold((0, 0), |(count, total), pair| (count + 1, total + weight(pair)));
            if best.is_none_or(|(most, _)| total > most) {
                best = Some((total, matrix));
                draws = draws_needed(f64::from(count) / pairs.len() as f64).min(MAX_DRAWS);
            }
        }
        matrices = seven_point(sample(pairs, random));
    }
    best.map(|(_, matrix)| matrix)
}

/// Draws after which every sample had a wrong match with a chance of [`MISSED`] only.
fn draws_needed(right: f64) -> usize {
    (MISSED.ln() / (-right.powi(SAMPLE as i32)).ln_1p()).ceil() as usize
}

fn sample<'a>(pairs: &'a [Correspondence], random: &mut ChaCha8Rng) -> [&'a Correspondence; SAMPLE] {
    let mut chosen = [usize::MAX; SAMPLE];
    for position in 0..SAMPLE {
        while chosen[position] == usize::MAX {
            let index = random.random_range(0..pairs.len());
            if !chosen[..position].contains(&index) {
                chosen[position] = index;
            }
        }
    }
    chosen.map(|index| &pairs[index])
}
