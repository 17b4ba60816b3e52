//! How far a trajectory is from the truth, laid over it.

use nalgebra::{Complex, Vector2};
use posegraph::{PlanarPose, Pose};

/// How an estimate is laid over the truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Alignment {
    /// The first pose of both is one, position and heading.
    FirstPose,
    /// Turned and moved to where the squares of the distances add up to least.
    Rigid,
    /// Scaled as well: what is left is not the wheels' scale, which no loop shows.
    Similarity,
}

/// Positions of `estimate` in the frame of `truth`: of each of the two the same moments, in order.
pub(crate) fn aligned(
    estimate: &[PlanarPose],
    truth: &[PlanarPose],
    alignment: Alignment,
) -> Vec<Vector2<f64>> {
    let (Some(first), Some(true_first)) = (estimate.first(), truth.first()) else { return Vec::new() };
    if alignment == Alignment::FirstPose {
        let laid = true_first.compose(&first.inverse());
        return estimate.iter().map(|pose| position(&laid.compose(pose))).collect();
    }
    let complex = |pose: &PlanarPose| Complex::new(pose.x_m(), pose.y_m());
    let mean = |poses: &[PlanarPose]| poses.iter().map(complex).sum::<Complex<f64>>() / poses.len() as f64;
    let from = mean(estimate);
    let to = mean(truth);
    // The best turn is the argument of Σ (p - p̄)* (q - q̄), the best turn and scale that over Σ |p - p̄|².
    let pairs = estimate.iter().zip(truth);
    let moment: Complex<f64> = pairs.map(|(a, b)| (complex(a) - from).conj() * (complex(b) - to)).sum();
    let spread: f64 = estimate.iter().map(|pose| (complex(pose) - from).norm_sqr()).sum();
    let none = Complex::new(1.0, 0.0);
    let motion = match alignment {
        Alignment::Similarity if spread > 0.0 => moment / spread,
        Alignment::FirstPose | Alignment::Rigid | Alignment::Similarity if moment.norm() > 0.0 => {
            moment / moment.norm()
        }
        Alignment::FirstPose | Alignment::Rigid | Alignment::Similarity => none,
    };
    let laid = estimate.iter().map(|pose| to + motion * (complex(pose) - from));
    laid.map(|point| Vector2::new(point.re, point.im)).collect()
}

/// Root of the mean squared distance between the two, in metres; 0 of none.
pub(crate) fn rmse_m(estimate: &[PlanarPose], truth: &[PlanarPose], alignment: Alignment) -> f64 {
    let laid = aligned(estimate, truth, alignment);
    let squares: f64 =
        laid.iter().zip(truth).map(|(point, truth)| (point - position(truth)).norm_squared()).sum();
    if laid.is_empty() { 0.0 } else { (squares / laid.len() as f64).sqrt() }
}

/// Where a pose is.
pub(crate) fn position(pose: &PlanarPose) -> Vector2<f64> {
    Vector2::new(pose.x_m(), pose.y_m())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Vec<PlanarPose>> {
        let pose = (-9.0..9.0f64, -9.0..9.0f64, -3.0..3.0f64);
        proptest::collection::vec(pose.prop_map(|(x, y, heading)| PlanarPose::new(x, y, heading)), 3..20)
    }

    proptest! {
        #[test]
        fn what_was_only_moved_is_laid_over_itself(
            truth in poses(), (x, y, turn) in (-9.0..9.0f64, -9.0..9.0f64, -3.0..3.0f64), scale in 0.5..2.0f64,
        ) {
            let moved = PlanarPose::new(x, y, turn);
            let other: Vec<PlanarPose> = truth.iter().map(|pose| moved.compose(pose)).collect();
            for alignment in [Alignment::FirstPose, Alignment::Rigid, Alignment::Similarity] {
                prop_assert!(rmse_m(&other, &truth, alignment) < 1e-9);
            }
            let larger = |pose: &PlanarPose| PlanarPose::new(scale * pose.x_m(), scale * pose.y_m(), pose.heading_rad());
            let scaled: Vec<PlanarPose> = other.iter().map(larger).collect();
            prop_assert!(rmse_m(&scaled, &truth, Alignment::Similarity) < 1e-9);
        }

        /// No small turn or move makes the best one better.
        #[test]
        fn the_best_alignment_is_the_best(truth in poses(), other in poses(), step in prop::array::uniform3(-0.1..0.1f64)) {
            let count = truth.len().min(other.len());
            let (truth, other) = (&truth[..count], &other[..count]);
            let best = rmse_m(other, truth, Alignment::Rigid);
            let laid = aligned(other, truth, Alignment::Rigid);
            let step = PlanarPose::new(step[0], step[1], step[2]);
            let moved: f64 = laid.iter().zip(truth).map(|(point, truth)| {
                let point = step.compose(&PlanarPose::new(point.x, point.y, 0.0));
                (position(&point) - position(truth)).norm_squared()
            }).sum();
            prop_assert!(best <= (moved / count as f64).sqrt() + 1e-12);
            prop_assert!(rmse_m(other, truth, Alignment::Similarity) <= best + 1e-12);
            prop_assert!(best <= rmse_m(other, truth, Alignment::FirstPose) + 1e-12);
        }
    }
}
