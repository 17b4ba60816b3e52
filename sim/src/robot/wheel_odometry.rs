//! Where the wheels say that the robot is.

use nalgebra::{Matrix2, Matrix3, Matrix3x2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::pose::Pose;
use crate::random::{Draws, derived_seed, standard_normal};
use crate::range::{self, OutOfRange};

/// How wrong wheels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelErrors {
    /// Measured way = (1 + scale) true way, in (-0.5, 0.5).
    pub scale: f64,
    /// The wheels see a turn of so much per metre driven that is none, in radians per metre.
    pub drift_rad_per_m: f64,
    /// Standard deviation of the way, per square root of metres driven, in m/√m.
    pub way_sigma: f64,
    /// Standard deviation of the heading, per square root of metres driven, in rad/√m.
    pub heading_sigma: f64,
    /// Standard deviation of the heading, per square root of radians turned, in rad/√rad.
    pub turn_sigma: f64,
    /// How often a wheel slips, per metre.
    pub slips_per_m: f64,
    /// How far a slipping wheel turns without grip, in metres.
    pub slip_m: f64,
}

impl WheelErrors {
    /// Wheels that are always right.
    pub const NONE: Self = Self {
        scale: 0.0,
        drift_rad_per_m: 0.0,
        way_sigma: 0.0,
        heading_sigma: 0.0,
        turn_sigma: 0.0,
        slips_per_m: 0.0,
        slip_m: 0.0,
    };
    /// Largest scale error that [`WheelErrors::drawn`] gives.
    pub const MAX_SCALE: f64 = 0.05;
    /// Largest drift that [`WheelErrors::drawn`] gives: 3 degrees per metre.
    pub const MAX_DRIFT_RAD_PER_M: f64 = 3.0 * std::f64::consts::PI / 180.0;

    /// Uncalibrated wheels: scale within ±5 % and drift within ±3 degrees per metre, evenly, with a
    /// little noise.
    #[must_use]
    pub fn drawn(seed: u64) -> Self {
        let mut draws = Draws::new(derived_seed(seed, 0xb1a5));
        Self::biased(
            draws.between(-Self::MAX_SCALE, Self::MAX_SCALE),
            draws.between(-Self::MAX_DRIFT_RAD_PER_M, Self::MAX_DRIFT_RAD_PER_M),
        )
    }

    /// That scale and that drift, with a little noise: 1 % of a metre, 0.3 degrees per √m, 0.6
    /// degrees per √rad.
    #[must_use]
    pub const fn biased(scale: f64, drift_rad_per_m: f64) -> Self {
        Self { scale, drift_rad_per_m, way_sigma: 0.01, heading_sigma: 0.005, turn_sigma: 0.01, ..Self::NONE }
    }

    /// # Errors
    /// [`OutOfRange`] if a number is out of its range.
    pub fn checked(self) -> Result<Self, OutOfRange> {
        range::check(&[
            ("scale", self.scale, -0.5, 0.5),
            ("drift_rad_per_m", self.drift_rad_per_m, -1.0, 1.0),
            ("way_sigma", self.way_sigma, 0.0, 1.0),
            ("heading_sigma", self.heading_sigma, 0.0, 1.0),
            ("turn_sigma", self.turn_sigma, 0.0, 1.0),
            ("slips_per_m", self.slips_per_m, 0.0, 10.0),
            ("slip_m", self.slip_m, 0.0, 1.0),
        ])?;
        Ok(self)
    }
}

/// Where wheels say that the robot is, and how sure they are.
#[derive(Clone, Debug)]
pub struct WheelOdometry {
    errors: WheelErrors,
    random: ChaCha8Rng,
    reading: OdometryReading,
}

/// A pose in the odometry's own frame, which starts at (0, 0, 0), and how sure it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryReading {
    /// Where the wheels say the robot is.
    pub pose: Pose,
    /// Covariance of (x, y, heading) in m², m rad and rad², as a driver states it that knows of its
    /// wheels no more than how wrong uncalibrated ones may be: what a bias does within a metre
    /// counts as noise.
    pub covariance: Matrix3<f64>,
}

impl OdometryReading {
    /// The covariance of (x, y, z, rotation about x, y, z), 6 x 6 row by row: the floor is level to
    /// a millimetre and a milliradian.
    #[must_use]
    pub fn covariance_6x6(&self) -> [f64; 36] {
        let mut whole = [0.0; 36];
        for (row, &to_row) in [0, 1, 5].iter().enumerate() {
            for (column, &to_column) in [0, 1, 5].iter().enumerate() {
                whole[6 * to_row + to_column] = self.covariance[(row, column)];
            }
        }
        for axis in [2, 3, 4] {
            whole[7 * axis] = 1e-6;
        }
        whole
    }

    /// Position as x, y, z and orientation as the quaternion x, y, z, w.
    #[must_use]
    pub fn position_and_orientation(&self) -> ([f64; 3], [f64; 4]) {
        let (sin, cos) = (self.pose.heading_rad / 2.0).sin_cos();
        ([self.pose.x_m, self.pose.y_m, 0.0], [0.0, 0.0, sin, cos])
    }
}

impl WheelOdometry {
    /// Wheels that have not turned yet. Steps that were not driven here, such as those of a
    /// recorded trajectory, can be added as well.
    ///
    /// # Errors
    /// [`OutOfRange`] if the errors are.
    pub fn new(errors: WheelErrors, seed: u64) -> Result<Self, OutOfRange> {
        let reading = OdometryReading { pose: Pose::default(), covariance: Matrix3::zeros() };
        Ok(Self { errors: errors.checked()?, random: ChaCha8Rng::seed_from_u64(seed), reading })
    }

    /// How wrong it is; only the simulation knows.
    #[must_use]
    pub fn errors(&self) -> &WheelErrors {
        &self.errors
    }

    /// What they say now.
    #[must_use]
    pub fn reading(&self) -> &OdometryReading {
        &self.reading
    }

    /// The wheels have turned for so many metres ahead, along an arc, and so many radians to the
    /// left.
    pub fn add(&mut self, distance_m: f64, turn_rad: f64) {
        let errors = &self.errors;
        let way = distance_m.abs();
        let turned = turn_rad.abs();
        let distance_noise = errors.way_sigma * way.sqrt() * standard_normal(&mut self.random);
        let turn_variance = errors.heading_sigma.powi(2) * way + errors.turn_sigma.powi(2) * turned;
        let turn_noise = turn_variance.sqrt() * standard_normal(&mut self.random);
        let measured_m = distance_m * (1.0 + errors.scale) + distance_noise;
        let measured_rad = turn_rad + errors.drift_rad_per_m * way + turn_noise;
        self.propagate(measured_m, measured_rad);
        self.reading.pose = self.reading.pose.driven(measured_m, measured_rad);
    }

    /// Σ ← F Σ Fᵀ + G Q Gᵀ for a step that is short against its radius.
    fn propagate(&mut self, distance_m: f64, turn_rad: f64) {
        let heading = self.reading.pose.heading_rad + turn_rad / 2.0;
        let (sin, cos) = heading.sin_cos();
        let way = distance_m.abs();
        let turned = turn_rad.abs();
        let bias = |most: f64| most * most / 3.0;
        let distance_variance = (1e-4 + bias(WheelErrors::MAX_SCALE)) * way;
        let turn_variance = (2.5e-5 + bias(WheelErrors::MAX_DRIFT_RAD_PER_M)) * way + 1e-4 * turned;
        let motion = Matrix3::new(1.0, 0.0, -distance_m * sin, 0.0, 1.0, distance_m * cos, 0.0, 0.0, 1.0);
        let input = Matrix3x2::new(cos, -distance_m / 2.0 * sin, sin, distance_m / 2.0 * cos, 0.0, 1.0);
        let noise = Matrix2::new(distance_variance, 0.0, 0.0, turn_variance);
        let covariance = &mut self.reading.covariance;
        *covariance = motion * *covariance * motion.transpose() + input * noise * input.transpose();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Rotation2, Vector2};

    #[test]
    fn the_covariance_is_one_and_grows() {
        let mut odometry = WheelOdometry::new(WheelErrors::drawn(3), 3).unwrap();
        let mut before = 0.0;
        for step in 0..200 {
            odometry.add(0.02, 0.01 * f64::from(step % 7));
            let whole = Matrix6::from_row_slice(&odometry.reading().covariance_6x6());
            assert!((whole - whole.transpose()).amax() < 1e-12);
            assert!(whole.symmetric_eigenvalues().min() > -1e-12);
            assert!(odometry.reading().covariance.trace() > before);
            before = odometry.reading().covariance.trace();
        }
        // A turn by a quaternion is the heading.
        let ([x, y, _], [_, _, sin, cos]) = odometry.reading().position_and_orientation();
        let ahead = Rotation2::new(2.0 * sin.atan2(cos)) * Vector2::x();
        let pose = odometry.reading().pose;
        assert!((ahead - pose.direction()).norm() < 1e-12 && [x, y] == [pose.x_m, pose.y_m]);
    }

    #[test]
    fn wheels_that_are_none_are_refused() {
        let refused =
            WheelOdometry::new(WheelErrors { scale: f64::NAN, ..WheelErrors::NONE }, 1).unwrap_err();
        assert_eq!((refused.setting, refused.least, refused.most), ("scale", -0.5, 0.5));
    }
}
