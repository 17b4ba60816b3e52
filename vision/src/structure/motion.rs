//! How the robot moved between two frames: what wheels say, set right by the two images.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use posegraph::{PlanarPose, Pose};
use topomap::metric::RelativePose;

use super::robot_camera::{RobotCamera, Sighted};

/// A feature, as it is seen from the earlier and from the later pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub(super) earlier: Sighted,
    pub(super) later: Sighted,
}

/// Factors of the tolerance, from coarse to fine: wheels that are off by a few degrees move all
/// features by many pixels.
const TOLERANCES: [f64; 4] = [8.0, 4.0, 2.0, 1.0];

/// Steps for each of them.
const STEPS: usize = 3;

/// For derivatives by central differences, in metres and radians.
const DIFFERENCE: f64 = 1e-6;

/// The motion that pairs and wheels agree on best, with its covariance: wheels as a prior, and the
/// pairs' distances from their epipolar lines with a robust kernel.
pub(super) fn refined(camera: &RobotCamera, pairs: &[Pair], wheels: &RelativePose) -> RelativePose {
    let prior = wheels.information();
    let mut motion = *wheels.pose();
    let mut information = prior;
    for tolerance in TOLERANCES {
        for _ in 0..STEPS {
            let off = PlanarPose::error(wheels.pose(), &PlanarPose::identity(), &motion);
            let mut gradient = prior * off;
            information = prior;
            let ends = epipoles_around(camera, &motion);
            let here = Epipolar::of(camera, &motion);
            for pair in pairs {
                let Some(distance) = here.distance(pair) else { continue };
                let scaled = distance / tolerance;
                let weight = 1.0 / (1.0 + scaled * scaled);
                let slope = |axis: usize| {
                    let [ahead, behind] = &ends[axis];
                    ahead
                        .distance(pair)
                        .zip(behind.distance(pair))
                        .map_or(0.0, |(ahead, behind)| (ahead - behind) / (2.0 * DIFFERENCE))
                };
                let slope = Vector3::new(slope(0), slope(1), slope(2));
                information += slope * slope.transpose() * weight;
                gradient += slope * (distance * weight);
            }
            let Some(factor) = information.cholesky() else { return *wheels };
            let step = -factor.solve(&gradient);
            if step.iter().any(|value| !value.is_finite()) {
                return *wheels;
            }
            motion = motion.retract(&step);
        }
    }
    let covariance = information.try_inverse().unwrap_or(*wheels.covariance());
    RelativePose::new(motion, symmetric(&covariance)).unwrap_or(*wheels)
}

fn epipoles_around(camera: &RobotCamera, motion: &PlanarPose) -> [[Epipolar; 2]; 3] {
    [0, 1, 2].map(|axis| {
        [DIFFERENCE, -DIFFERENCE].map(|by| {
            let step = Vector3::from_fn(|row, _| if row == axis { by } else { 0.0 });
            Epipolar::of(camera, &motion.retract(&step))
        })
    })
}

/// aᵀ E b = 0 of the rays a and b of one feature. Hartley & Zisserman 2004, eq. (9.12).
struct Epipolar(Matrix3<f64>);

impl Epipolar {
    fn of(camera: &RobotCamera, motion: &PlanarPose) -> Self {
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, motion.heading_rad());
        let shift = super::robot_camera::carried(motion, &camera.center_m()) - camera.center_m();
        let mounted = camera.rotation();
        let [turn, shift] = [
            (mounted.inverse() * turn * mounted).to_rotation_matrix().into_inner(),
            (mounted.inverse() * shift).cross_matrix(),
        ];
        Self(shift * turn)
    }

    /// The Sampson distance, in standard deviations of where the features lie. Hartley & Zisserman
    /// 2004, eq. (11.9). `None` where it has no slope: at the epipoles, or without a shift.
    fn distance(&self, pair: &Pair) -> Option<f64> {
        let (a, b) = (pair.earlier.ray(), pair.later.ray());
        let (line_in_earlier, line_in_later) = (self.0 * b, self.0.tr_mul(&a));
        let variance = pair.earlier.sigma.powi(2) * line_in_earlier.yz().norm_squared()
            + pair.later.sigma.powi(2) * line_in_later.yz().norm_squared();
        (variance > f64::MIN_POSITIVE).then(|| a.dot(&line_in_earlier) / variance.sqrt())
    }
}

pub(super) fn symmetric(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}
