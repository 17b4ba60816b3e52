//! Whether wheels can be so wrong that a robot is back where it was.

use posegraph::{PlanarPose, Pose};

use super::odometry_noise::OdometryNoise;
use super::relative_pose::RelativePose;
use super::wheel_drift::without_drift;

/// Expected deviations that wheels are within.
const MOST_DEVIATIONS: f64 = 3.0;

/// How far the end of a way is from its beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WheelReach {
    /// At least, by the steady drift that brings the two nearest, in metres.
    pub(crate) least_m: f64,
    /// By which wheels may be wrong beside that, in metres.
    pub(crate) error_m: f64,
}

/// Ways that are looked at, of wheels that hardly drift.
const LONGEST_M: f64 = 100.0;

impl WheelReach {
    /// Metres after which a steady drift can have bent a straight way into a circle: of longer ways
    /// nothing is said.
    pub(crate) fn longest_m(noise: &OdometryNoise) -> f64 {
        (std::f64::consts::TAU / (MOST_DEVIATIONS * noise.heading_rad_per_m)).min(LONGEST_M)
    }

    /// Of a way that wheels `measured` step by step. `resolution_m`, above 0, is how closely drifts
    /// are tried.
    pub(crate) fn of(measured: &[RelativePose], noise: &OdometryNoise, resolution_m: f64) -> Self {
        let length_m: f64 = measured.iter().map(|step| distance_m(step.pose())).sum();
        let most_rad_per_m = MOST_DEVIATIONS * noise.heading_rad_per_m;
        let tried = (most_rad_per_m * length_m * length_m / (2.0 * resolution_m)).ceil().clamp(1.0, 200.0);
        let drifts = (-tried as i32..=tried as i32).map(|step| most_rad_per_m * f64::from(step) / tried);
        let apart_m = |drift: f64| {
            let step = |at: PlanarPose, step: &RelativePose| at.compose(&without_drift(step.pose(), drift));
            distance_m(&measured.iter().fold(PlanarPose::identity(), step))
        };
        let way = measured.iter().fold(RelativePose::none(), |way, step| way.then(step));
        let covariance = way.covariance();
        Self {
            least_m: drifts.map(apart_m).fold(f64::INFINITY, f64::min),
            error_m: MOST_DEVIATIONS * (covariance[(0, 0)] + covariance[(1, 1)]).sqrt(),
        }
    }
}

fn distance_m(pose: &PlanarPose) -> f64 {
    pose.x_m().hypot(pose.y_m())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reach(steps: &[PlanarPose]) -> WheelReach {
        let noise = OdometryNoise::default();
        let measured: Vec<_> = steps.iter().map(|step| noise.of_motion(step)).collect();
        WheelReach::of(&measured, &noise, 0.8)
    }

    #[test]
    fn a_straight_way_is_no_loop() {
        let straight = reach(&[PlanarPose::new(0.8, 0.0, 0.0); 22]);
        // The chord of 17.6 m on a circle with 0.15 rad to the metre.
        let chord_m = 2.0 / 0.15 * (0.15_f64 * 17.6 / 2.0).sin();
        assert!((straight.least_m - chord_m).abs() < 0.05, "{straight:?}, not {chord_m}");
        assert!(straight.error_m < 0.6 * straight.least_m, "{straight:?}");
    }

    proptest! {
        /// Round a square, with wheels that drift: the way closes, whatever they say.
        #[test]
        fn a_loop_is_one_with_any_drift(side in 3..8usize, drift in -0.14..0.14f64) {
            let turn = |step: usize| if step.is_multiple_of(side) { std::f64::consts::FRAC_PI_2 } else { 0.0 };
            let steps = (1..=4 * side).map(|step| without_drift(&PlanarPose::new(1.0, 0.0, turn(step)), -drift));
            let reach = reach(&steps.collect::<Vec<_>>());
            prop_assert!(reach.least_m <= reach.error_m + 0.8, "{:?}", reach);
        }
    }
}
