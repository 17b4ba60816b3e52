//! Where the wheels say the robot may be now, given where it may have been.
//!
//! Of each of the last steps, prediction_s(i) = Σ_j N(x_i ⊖ (x_j ⊕ u); 0, Σ_u + Σ_cell) p(L_j | Z^{k-s}), where u is what odometry
//! has measured since. The prior is the element-wise maximum over the steps: a robot that was sure a while ago and
//! saw nothing known since is not forgotten, and the steps disagree where the map is coarse.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use fabmap::place_filter::{Belief, MotionPrior};
use nalgebra::{Matrix3, Vector3};

use crate::place_poses::PlacePoses;
use crate::relative_pose::RelativePose;
use crate::relaxation::{PlanarPose, Pose};

/// How far apart places are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceSpacing {
    /// In metres, above 0.
    pub distance_m: f64,
    /// Of headings, in radians, above 0.
    pub angle_rad: f64,
}

impl Default for PlaceSpacing {
    fn default() -> Self {
        Self { distance_m: 0.5, angle_rad: 10_f64.to_radians() }
    }
}

impl PlaceSpacing {
    /// Whether a robot at `pose` in a place's frame is still there.
    #[must_use]
    pub fn holds(&self, pose: &PlanarPose) -> bool {
        pose.x_m().hypot(pose.y_m()) <= self.distance_m && pose.heading_rad().abs() <= self.angle_rad
    }

    /// Σ_cell.
    fn covariance(&self) -> Matrix3<f64> {
        let deviations = Vector3::new(self.distance_m, self.distance_m, self.angle_rad);
        Matrix3::from_diagonal(&deviations.map(|deviation| deviation * deviation))
    }
}

/// Standard deviations that a robot is looked for within.
const REACH_SIGMAS: f64 = 3.5;

/// The prior for the next frame. `steps` are beliefs of the last frames, latest first, each with the motion since;
/// none with a pose means an even prior.
#[must_use]
pub fn predict<'a>(
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
    let (mut known, mut elsewhere) = (None, 1.0);
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
mod tests {
    use super::*;
    use crate::event::{Link, LinkKind};
    use crate::relative_pose::OdometryNoise;

    /// Places in a row, 0.5 m apart, and one more that nothing leads to.
    fn row(places: u32) -> PlacePoses {
        let step = RelativePose::new(PlanarPose::new(0.5, 0.0, 0.0), Matrix3::identity() * 1e-4).unwrap();
        let links: Vec<Link> = (1..places)
            .map(|place| Link { from: place - 1, to: place, kind: LinkKind::Driven(step) })
            .collect();
        PlacePoses::new(vec![0; places as usize + 1], &links, &OdometryNoise::default())
    }

    fn at(places: Vec<(PlaceId, f64)>) -> Belief {
        let on_places: f64 = places.iter().map(|(_, probability)| probability).sum();
        Belief { places, new_place: (1.0 - on_places) / 2.0, remainder: (1.0 - on_places) / 2.0 }
    }

    fn moved(x_m: f64, y_m: f64, heading_rad: f64) -> RelativePose {
        RelativePose::new(PlanarPose::new(x_m, y_m, heading_rad), Matrix3::identity() * 1e-4).unwrap()
    }

    /// The weight of each place, and their sum.
    fn spread(steps: &[(&Belief, RelativePose)], places: u32) -> (Vec<f64>, f64) {
        let predicted = merged(steps.iter().copied(), &row(places), &PlaceSpacing::default());
        let mut weights = vec![0.0; places as usize + 1];
        predicted.places.iter().for_each(|&(place, weight)| weights[place as usize] = weight);
        let sum: f64 = weights.iter().sum();
        assert!((sum + predicted.elsewhere - 1.0).abs() < 1e-12);
        (weights, sum)
    }

    #[test]
    fn the_robot_is_expected_where_it_has_driven() {
        let belief = at(vec![(2, 0.9)]);
        let (weights, sum) = spread(&[(&belief, moved(1.0, 0.0, 0.0))], 8);
        let best = (0..=8).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap();
        assert_eq!(best, 4);
        assert!((sum - 0.9).abs() < 1e-12);
        // Formula by hand: neighbours are one spacing off.
        let ratio = weights[3] / weights[4];
        assert!((ratio - (-0.5 * 0.25 / (0.25 + 1e-4_f64)).exp()).abs() < 1e-12, "{ratio}");
        // Backwards, having turned round, is not where places look the other way.
        let (turned, sum) = spread(&[(&belief, moved(0.5, 0.0, 3.0))], 8);
        assert_eq!(sum, 0.0, "{turned:?}");
    }

    #[test]
    fn the_largest_of_all_steps_counts() {
        let (sure, vague) = (at(vec![(0, 0.8)]), at(vec![(6, 0.4)]));
        let steps = [(&vague, moved(0.5, 0.0, 0.0)), (&sure, moved(1.5, 0.0, 0.0))];
        let (weights, sum) = spread(&steps, 10);
        assert!((sum - 0.4).abs() < 1e-12, "as much as the latest belief has on places: {sum}");
        assert!(weights[3] > weights[7] && weights[7] > weights[5]);
    }

    #[test]
    fn places_near_are_those_within_the_distance_however_far_it_reaches() {
        let poses = row(30);
        for (x_m, distance_m) in [(3.2, 0.6), (7.0, 2.0), (7.0, 4.0), (-50.0, 52.0), (1e8, 1e9), (0.0, 1e300)]
        {
            let mut near: Vec<PlaceId> =
                poses.near(0, [x_m, 0.0], distance_m).map(|(place, _)| place).collect();
            near.sort_unstable();
            let expected: Vec<PlaceId> =
                (0..30).filter(|&place| (0.5 * f64::from(place) - x_m).abs() <= distance_m).collect();
            assert_eq!(near, expected, "{distance_m} m round {x_m}");
        }
        let alone: Vec<_> = poses.near(30, [0.0; 2], 1e6).map(|(place, _)| place).collect();
        assert_eq!((alone, poses.near(77, [0.0; 2], 1e6).count()), (vec![30], 0));
    }

    #[test]
    fn what_has_no_neighbours_within_reach_is_even() {
        let belief = at(vec![(10, 0.7)]);
        let (weights, sum) = spread(&[(&belief, moved(5.0, 0.0, 0.0))], 10);
        assert_eq!(sum, 0.0, "{weights:?}");
        assert_eq!(predict([], &row(3), &PlaceSpacing::default()), MotionPrior::even());
    }
}
