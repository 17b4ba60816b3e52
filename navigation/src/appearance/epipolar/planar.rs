//! Motion on a floor: E = [[0, 0, e3], [0, 0, e6], [e7, e8, 0]].

use std::f64::consts::PI;

use nalgebra::{Matrix2, Matrix3, Rotation3, SMatrix, SVector, Unit, Vector2, Vector3};

use super::{Motion, RayPair, behind_both_rad};

/// A motion in the plane of the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarMotion {
    rotation_rad: f64,
    heading_rad: f64,
}

impl PlanarMotion {
    /// From the angle of R, counter-clockwise, and that of d.
    #[must_use]
    pub fn new(rotation_rad: f64, heading_rad: f64) -> Self {
        Self { rotation_rad: wrapped(rotation_rad), heading_rad: wrapped(heading_rad) }
    }

    /// Angle of R, in (-π, π]: how much further to the left the target was looking than the robot
    /// is now.
    #[must_use]
    pub fn rotation_rad(&self) -> f64 {
        self.rotation_rad
    }

    /// φ = atan2(d_y, d_x), in (-π, π]: where the target is, from straight ahead to the left.
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        self.heading_rad
    }

    /// E = R \[t\]ₓ with |t| = 1.
    #[must_use]
    pub fn essential_matrix(&self) -> Matrix3<f64> {
        // t = -Rᵀ d.
        let translation = -(self.rotation().inverse() * self.direction().into_inner());
        self.rotation() * translation.cross_matrix()
    }

    /// From the directions (e6, -e3) of d and (e8, -e7) of t, whose R t = -d.
    fn of_angles(way_rad: f64, translation_rad: f64) -> Self {
        Self::new(way_rad + PI - translation_rad, way_rad)
    }
}

impl Motion for PlanarMotion {
    const SAMPLE: usize = 4;

    fn rotation(&self) -> Rotation3<f64> {
        Rotation3::from_axis_angle(&Vector3::z_axis(), self.rotation_rad)
    }

    fn direction(&self) -> Unit<Vector3<f64>> {
        let (sine, cosine) = self.heading_rad.sin_cos();
        Unit::new_unchecked(Vector3::new(cosine, sine, 0.0))
    }

    /// Of the four motions that share an essential matrix two turn the camera upside down: no robot
    /// on a floor does. The other two are the way there and the way back.
    fn fit(pairs: &[RayPair]) -> Option<Self> {
        let [e3, e6, e7, e8] = least_entries(pairs)?;
        let there = Self::of_angles((-e3).atan2(e6), (-e7).atan2(e8));
        let back = Self::new(there.rotation_rad, there.heading_rad + PI);
        let is_there = behind_both_rad(&there, pairs) <= behind_both_rad(&back, pairs);
        Some(if is_there { there } else { back })
    }

    /// Gauss-Newton on the two angles, with the sum of squared Sampson distances.
    fn refined(self, pairs: &[RayPair]) -> Self {
        let mut motion = self;
        for _ in 0..GAUSS_NEWTON_STEPS {
            let Some(step) = motion.step(pairs) else { break };
            motion = Self::of_angles(
                motion.heading_rad + step.x,
                motion.heading_rad + PI - motion.rotation_rad + step.y,
            );
        }
        motion
    }
}

const GAUSS_NEWTON_STEPS: usize = 3;

impl PlanarMotion {
    /// Changes of the angles of d and of t.
    fn step(&self, pairs: &[RayPair]) -> Option<Vector2<f64>> {
        let essential = self.essential_matrix();
        let (way_sine, way_cosine) = self.heading_rad.sin_cos();
        let (sine, cosine) = (self.heading_rad + PI - self.rotation_rad).sin_cos();
        let mut moments = Matrix2::zeros();
        let mut right = Vector2::zeros();
        for RayPair { current, target } in pairs {
            let line = essential * target;
            let back = essential.tr_mul(current);
            // Only the parts across the rays turn them.
            let residual = current.dot(&line);
            let slope = line.norm_squared() + back.norm_squared() - 2.0 * residual * residual;
            let weight = 1.0 / slope.max(1e-9);
            let gradient = Vector2::new(
                -target.z * (way_cosine * current.x + way_sine * current.y),
                -current.z * (cosine * target.x + sine * target.y),
            );
            moments += weight * gradient * gradient.transpose();
            right -= weight * residual * gradient;
        }
        moments.cholesky().map(|factor| factor.solve(&right))
    }
}

/// e3, e6, e7 and e8 with the least sum of squares of
/// z2 (e3 x1 + e6 y1) + z1 (e7 x2 + e8 y2) = 0.
fn least_entries(pairs: &[RayPair]) -> Option<[f64; 4]> {
    let mut moments = SMatrix::<f64, 4, 4>::zeros();
    for RayPair { current, target } in pairs {
        let row = SVector::<f64, 4>::new(
            target.z * current.x,
            target.z * current.y,
            current.z * target.x,
            current.z * target.y,
        );
        moments += row * row.transpose();
    }
    let eigen = moments.symmetric_eigen();
    let entries = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let [e3, e6, e7, e8]: [f64; 4] = entries.into();
    // Of a motion both halves have the same length.
    let halves = [e3.hypot(e6), e7.hypot(e8)];
    (halves.iter().all(|half| half.is_finite() && *half > 0.05)).then_some([e3, e6, e7, e8])
}

fn wrapped(angle_rad: f64) -> f64 {
    let (sine, cosine) = angle_rad.sin_cos();
    sine.atan2(cosine)
}
