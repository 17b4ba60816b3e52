//! The motion of a camera in space, fitted to matches within its own five degrees of freedom.

use nalgebra::{Matrix3, SMatrix, SVector, Unit, UnitQuaternion, UnitVector3, Vector3};

use super::correspondence::Correspondence;
use super::epipolar_matrices::sampson;

/// x_current = R x_earlier + t, |t| unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RigidMotion {
    /// R.
    pub(super) rotation: UnitQuaternion<f64>,
    /// t / |t|.
    pub(super) direction: UnitVector3<f64>,
}

/// A small turn, and a small turn of the direction about two axes across it, in radians.
type Step = SVector<f64, 5>;

/// Steps at most; it ends when none makes it better.
const MAX_STEPS: usize = 20;

/// For the derivative by central differences, in radians.
const DIFFERENCE: f64 = 1e-6;

/// Of Levenberg and Marquardt: at first, and beyond which no step is small enough.
const DAMPING: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e3;

impl RigidMotion {
    /// E = [t]ₓ R. Eq. (9.12).
    pub(super) fn essential_matrix(&self) -> Matrix3<f64> {
        self.direction.cross_matrix() * self.rotation.to_rotation_matrix().matrix()
    }

    /// The motion with the least Σ ln(1 + (d / tolerance)²) near this one, d the Sampson distances:
    /// matches far off hardly count. By Levenberg-Marquardt with reweighting.
    pub(super) fn refined(&self, pairs: &[Correspondence], tolerance: f64) -> Self {
        let mut motion = *self;
        let mut cost = self.cost(pairs, tolerance);
        let mut damping = DAMPING;
        for _ in 0..MAX_STEPS {
            let Some(step) = motion.step(pairs, tolerance, damping) else { break };
            let moved = motion.moved(&step);
            let moved_cost = moved.cost(pairs, tolerance);
            if moved_cost < cost {
                let settled = cost - moved_cost < 1e-6 * cost;
                (motion, cost, damping) = (moved, moved_cost, damping / 10.0);
                if settled {
                    break;
                }
            } else if damping > MAX_DAMPING {
                break;
            } else {
                damping *= 10.0;
            }
        }
        motion
    }

    fn cost(&self, pairs: &[Correspondence], tolerance: f64) -> f64 {
        let matrix = self.essential_matrix();
        pairs.iter().map(|pair| (sampson(&matrix, pair) / tolerance).powi(2).ln_1p()).sum()
    }

    fn step(&self, pairs: &[Correspondence], tolerance: f64, damping: f64) -> Option<Step> {
        let matrix = self.essential_matrix();
        let ends = [0, 1, 2, 3, 4].map(|parameter| {
            [DIFFERENCE, -DIFFERENCE].map(|by| {
                let step = Step::from_fn(|row, _| if row == parameter { by } else { 0.0 });
                self.moved(&step).essential_matrix()
            })
        });
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        let mut gradient = Step::zeros();
        for pair in pairs {
            let distance = sampson(&matrix, pair) / tolerance;
            let slope = Step::from_fn(|parameter, _| {
                let [ahead, behind] = &ends[parameter];
                (sampson(ahead, pair) - sampson(behind, pair)) / (2.0 * DIFFERENCE * tolerance)
            });
            let weight = 1.0 / (1.0 + distance * distance);
            normal += slope * slope.transpose() * weight;
            gradient += slope * (distance * weight);
        }
        let damped = normal + SMatrix::from_diagonal(&(normal.diagonal() * damping));
        damped
            .cholesky()
            .map(|factor| -factor.solve(&gradient))
            .filter(|step| step.iter().all(|x| x.is_finite()))
    }

    fn moved(&self, step: &Step) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let across = Unit::new_normalize(self.direction.cross(&least_axis(&self.direction)));
        let aside = self.direction.cross(&across) * step[4];
        let direction =
            UnitVector3::new_normalize(self.direction.into_inner() + across.into_inner() * step[3] + aside);
        Self { rotation: turn * self.rotation, direction }
    }
}

/// The axis that a direction is farthest from.
fn least_axis(direction: &Vector3<f64>) -> Vector3<f64> {
    Vector3::ith(direction.iamin(), 1.0)
}
