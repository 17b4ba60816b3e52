//! Where the wheels say the robot may be now, given where it may have been.
//!
//! Of each of the last steps, prediction_s(i) = Σ_j N(x_i ⊖ (x_j ⊕ u); 0, Σ_u + Σ_cell) p(L_j |
//! Z^{k-s}), where u is what odometry has measured since. The prior is the element-wise maximum
//! over the steps: a robot that was sure a while ago and saw nothing known since is not forgotten,
//! and the steps disagree where the map is coarse. The motion model of a histogram filter, Thrun,
//! Burgard & Fox, Probabilistic Robotics 2005, section 8.2, over places in the place of cells; the
//! maximum over several steps is our own.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use fabmap::place_filter::{Belief, MotionPrior};
use nalgebra::Vector3;

use crate::map::PlacePoses;
use crate::metric::{PlaceSpacing, RelativePose};
use posegraph::Pose;

/// Standard deviations that a robot is looked for within.
const REACH_SIGMAS: f64 = 3.5;

/// The prior for the next frame. `steps` are beliefs of the last frames, latest first, each with
/// the motion since; none with a pose means an even prior.
#[must_use]
pub(super) fn predict<'a>(
    steps: impl IntoIterator<Item = (&'a Belief, RelativePose)>,
    poses: &PlacePoses,
    spacing: &PlaceSpacing,
) -> MotionPrior {
    let Predicted { places, elsewhere } = merged(steps, poses, spacing);
    MotionPrior::from_weights(places, elsewhere)
}

/// Where the robot may be, before it is mixed with the chance of being anywhere.
#[derive(Clone, Debug, PartialEq)]
struct Predicted {
    places: Vec<(PlaceId, f64)>,
    elsewhere: f64,
}

fn merged<'a>(
    steps: impl IntoIterator<Item = (&'a Belief, RelativePose)>,
    poses: &PlacePoses,
    spacing: &PlaceSpacing,
) -> Predicted {
    let mut weights: BTreeMap<PlaceId, f64> = BTreeMap::new();
    let mut known = None;
    let mut elsewhere = 1.0;
    for (belief, motion) in steps {
        let predicted = prediction(belief, &motion, poses, spacing);
        let on_places: f64 = belief.places.iter().map(|(_, probability)| probability).sum();
        if known.is_none() {
            known = Some(on_places);
            elsewhere = belief.new_place + belief.remainder;
        }
        let total: f64 = predicted.values().sum();
        if total > 0.0 {
            for (place, weight) in predicted {
                let most = weights.entry(place).or_insert(0.0);
                *most = most.max(weight / total * on_places);
            }
        }
    }
    // The latest belief says how much is on places at all.
    let (total, known): (f64, f64) = (weights.values().sum(), known.unwrap_or(0.0));
    let scale = if total > 0.0 { known / total } else { 0.0 };
    let lost = if total > 0.0 { 0.0 } else { known };
    let places = weights.into_iter().map(|(place, weight)| (place, weight * scale)).collect();
    Predicted { places, elsewhere: elsewhere + lost }
}

/// prediction_s, not normalised.
fn prediction(
    belief: &Belief,
    motion: &RelativePose,
    poses: &PlacePoses,
    spacing: &PlaceSpacing,
) -> BTreeMap<PlaceId, f64> {
    let covariance = motion.covariance() + spacing.covariance();
    let reach_m = REACH_SIGMAS * covariance[(0, 0)].max(covariance[(1, 1)]).sqrt();
    let mut weights = BTreeMap::new();
    let Some(information) = covariance.try_inverse() else { return weights };
    for &(place, probability) in &belief.places {
        let (Some(from), Some(part)) = (poses.pose(place), poses.part(place)) else { continue };
        let expected = from.compose(motion.pose());
        for (near, pose) in poses.near(part, [expected.x_m(), expected.y_m()], reach_m) {
            let apart = expected.inverse().compose(pose);
            let apart = Vector3::new(apart.x_m(), apart.y_m(), apart.heading_rad());
            let exponent = -0.5 * apart.dot(&(information * apart));
            if exponent > -0.5 * REACH_SIGMAS * REACH_SIGMAS {
                *weights.entry(near).or_insert(0.0) += probability * exponent.exp();
            }
        }
    }
    weights
}

#[cfg(test)]
mod tests;
