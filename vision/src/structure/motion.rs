//! How the robot moved between two frames: what wheels say, set right by the two images.

use nalgebra::{Matrix3, Matrix5, SMatrix, Vector5};
use topomap::metric::RelativePose;

use super::nodding::Motion;
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

/// How the robot moved, with the covariance of the motion's steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refined {
    pub(super) motion: Motion,
    pub(super) covariance: Matrix5<f64>,
}

impl Refined {
    /// By wheels alone.
    pub(super) fn by(wheels: &RelativePose) -> Self {
        Self { motion: Motion::level(*wheels.pose()), covariance: Motion::covariance(wheels) }
    }
}

/// The motion that pairs and wheels agree on best: wheels as a prior, and the pairs' distances from
/// their epipolar lines with a robust kernel.
pub(super) fn refined(camera: &RobotCamera, pairs: &[Pair], wheels: &RelativePose) -> Refined {
    let prior = Motion::information(wheels);
    let mut motion = Motion::level(*wheels.pose());
    let mut information = prior;
    for tolerance in TOLERANCES {
        for _ in 0..STEPS {
            let mut gradient = prior * motion.off(wheels);
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
                let slope = Vector5::from(Motion::AXES.map(slope));
                information += slope * slope.transpose() * weight;
                gradient += slope * (distance * weight);
            }
            let Some(factor) = information.cholesky() else { return Refined::by(wheels) };
            let step = -factor.solve(&gradient);
            if step.iter().any(|value| !value.is_finite()) {
                return Refined::by(wheels);
            }
            motion = motion.retract(&step);
        }
    }
    let covariance = information.try_inverse().unwrap_or_else(|| Motion::covariance(wheels));
    Refined { motion, covariance: symmetric(&covariance) }
}

fn epipoles_around(camera: &RobotCamera, motion: &Motion) -> [[Epipolar; 2]; 5] {
    Motion::AXES
        .map(|axis| [DIFFERENCE, -DIFFERENCE].map(|by| Epipolar::of(camera, &motion.varied(axis, by))))
}

/// aᵀ E b = 0 of the rays a and b of one feature. Hartley & Zisserman 2004, eq. (9.12).
struct Epipolar(Matrix3<f64>);

impl Epipolar {
    fn of(camera: &RobotCamera, motion: &Motion) -> Self {
        let mounted = camera.rotation().to_rotation_matrix().into_inner();
        let shift = motion.carried(&camera.center_m()) - camera.center_m();
        let turn = mounted.tr_mul(motion.rotation()) * mounted;
        Self(mounted.tr_mul(&shift).cross_matrix() * turn)
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

pub(super) fn symmetric<const SIZE: usize>(matrix: &SMatrix<f64, SIZE, SIZE>) -> SMatrix<f64, SIZE, SIZE> {
    (matrix + matrix.transpose()) * 0.5
}
