//! How one pose lies to another, and how well that is known.

use fabmap::codec::{DecodeError, Reader, Writer};
use nalgebra::{Isometry3, Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3};

use crate::odometry::Odometry;
use crate::relaxation::{PlanarPose, Pose};
use crate::verification::{Motion, TwoView};

/// A pose in the frame of another, seen from above, with the covariance of what may be wrong about it: along its
/// own axes and about them, in m² and rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePose {
    pose: PlanarPose,
    covariance: Matrix3<f64>,
}

/// Numbers that measure nothing.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RelativePoseError {
    /// A number is NaN or infinite.
    #[error("a relative pose has a number that is not finite; leave it out if nothing was measured")]
    NotFinite,
    /// The covariance is none.
    #[error(
        "the covariance of a relative pose is not symmetric with no negative eigenvalue; give that of x, y and \
         heading, in m² and rad²"
    )]
    NotACovariance,
    /// The quaternion is no rotation.
    #[error(
        "the quaternion of a relative pose has length {norm}; send a unit quaternion as x, y, z, w, (0, 0, 0, 1) for none"
    )]
    NotUnit {
        /// Its length.
        norm: f64,
    },
    /// A number beyond all that robots measure.
    #[error("a relative pose has the number {value:e}; send metres, m² and rad²")]
    TooLarge {
        /// The number.
        value: f64,
    },
}

impl RelativePose {
    /// What was measured, and how well.
    ///
    /// # Errors
    /// [`RelativePoseError`] if a number is not finite or the covariance none.
    pub fn new(pose: PlanarPose, covariance: Matrix3<f64>) -> Result<Self, RelativePoseError> {
        if !pose.is_finite() || covariance.iter().any(|value| !value.is_finite()) {
            return Err(RelativePoseError::NotFinite);
        }
        let scale = covariance.amax();
        let symmetric = (covariance - covariance.transpose()).amax() <= 1e-6 * scale;
        if !symmetric || covariance.symmetric_eigenvalues().min() < -1e-6 * scale {
            return Err(RelativePoseError::NotACovariance);
        }
        Ok(Self { pose, covariance })
    }

    /// What was measured in space, seen from above. `covariance` is 6 x 6, row by row, of (x, y, z, rotation about x, y, z)
    /// about the axes that the pose is in, in m² and rad².
    ///
    /// # Errors
    /// [`RelativePoseError`] if a number is not finite or beyond all that robots measure, the quaternion is no rotation
    /// or the covariance none.
    pub fn measured_in_space(
        position_m: [f64; 3],
        orientation_xyzw: [f64; 4],
        covariance: &[f64; 36],
    ) -> Result<Self, RelativePoseError> {
        let within = |values: &[f64], most: f64| match values
            .iter()
            .find(|value| value.is_nan() || value.abs() > most)
        {
            Some(value) if value.is_finite() => Err(RelativePoseError::TooLarge { value: *value }),
            Some(_) => Err(RelativePoseError::NotFinite),
            None => Ok(()),
        };
        within(&position_m, Odometry::MAX_POSITION_M)?;
        within(covariance, Odometry::MAX_VARIANCE)?;
        let [i, j, k, w] = orientation_xyzw;
        let quaternion = Quaternion::new(w, i, j, k);
        let norm = quaternion.norm();
        if norm.is_nan() || (norm - 1.0).abs() > Odometry::MAX_NORM_ERROR {
            return Err(RelativePoseError::NotUnit { norm });
        }
        let rotation = UnitQuaternion::from_quaternion(quaternion);
        let pose =
            PlanarPose::seen_from_above(&Isometry3::from_parts(Vector3::from(position_m).into(), rotation));
        // From the axes that the pose is in to its own.
        let turned = PlanarPose::new(0.0, 0.0, pose.heading_rad()).inverse().adjoint();
        let covariance = Matrix6::from_row_slice(covariance);
        if (covariance - covariance.transpose()).amax() > 1e-6 * covariance.amax() {
            return Err(RelativePoseError::NotACovariance);
        }
        let covariance = seen_from_above(&covariance);
        Self::new(pose, turned * covariance * turned.transpose())
    }

    /// The very same pose.
    #[must_use]
    pub fn none() -> Self {
        Self { pose: PlanarPose::identity(), covariance: Matrix3::zeros() }
    }

    /// The pose.
    #[must_use]
    pub fn pose(&self) -> &PlanarPose {
        &self.pose
    }

    /// Covariance of x, y and heading, along the pose's own axes.
    #[must_use]
    pub fn covariance(&self) -> &Matrix3<f64> {
        &self.covariance
    }

    /// Standard deviation of the position in the direction in which it is largest, in metres.
    #[must_use]
    pub fn position_sigma_m(&self) -> f64 {
        let position = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        position.symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    /// `next`, which is measured from here, as measured from where this is measured from.
    #[must_use]
    pub fn then(&self, next: &RelativePose) -> Self {
        let carried = next.pose.inverse().adjoint();
        Self {
            pose: self.pose.compose(&next.pose),
            covariance: carried * self.covariance * carried.transpose() + next.covariance,
        }
    }

    /// Where this was measured from, as measured from here.
    #[must_use]
    pub fn back(&self) -> Self {
        let carried = self.pose.adjoint();
        Self { pose: self.pose.inverse(), covariance: carried * self.covariance * carried.transpose() }
    }

    /// Inverse of the covariance; what is known better than to a millimetre or a thousandth of a radian counts as
    /// known so well.
    #[must_use]
    pub fn information(&self) -> Matrix3<f64> {
        let symmetric = (self.covariance + self.covariance.transpose()) * 0.5;
        let floored = symmetric + Matrix3::from_diagonal_element(1e-6);
        floored.try_inverse().map_or_else(Matrix3::identity, |inverse| (inverse + inverse.transpose()) * 0.5)
    }

    pub(crate) fn encode(&self, writer: &mut Writer) {
        encode_planar(&self.pose, writer);
        self.covariance.iter().for_each(|&value| writer.f64(value));
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let pose = decode_planar(reader)?;
        let mut covariance = Matrix3::zeros();
        for value in covariance.iter_mut() {
            *value = reader.f64()?;
        }
        Self::new(pose, covariance).map_err(DecodeError::invalid)
    }
}

/// Appends x, y and heading; the bits of every number are kept.
pub(crate) fn encode_planar(pose: &PlanarPose, writer: &mut Writer) {
    [pose.x_m(), pose.y_m(), pose.heading_rad()].into_iter().for_each(|value| writer.f64(value));
}

pub(crate) fn decode_planar(reader: &mut Reader<'_>) -> Result<PlanarPose, DecodeError> {
    let pose = PlanarPose::new(reader.f64()?, reader.f64()?, reader.f64()?);
    if pose.is_finite() { Ok(pose) } else { Err(DecodeError::invalid("a pose")) }
}

/// How far wheels can be trusted, where their own covariance does not say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryNoise {
    /// Of a distance, at least 0.
    pub translation_share: f64,
    /// Of the heading, per metre driven, in rad/m, at least 0.
    pub heading_rad_per_m: f64,
    /// Of a turn, at least 0.
    pub turn_share: f64,
    /// Of any position, in metres, above 0.
    pub position_floor_m: f64,
    /// Of any heading, in radians, above 0.
    pub heading_floor_rad: f64,
}

impl Default for OdometryNoise {
    fn default() -> Self {
        Self {
            translation_share: 0.05,
            heading_rad_per_m: 0.05,
            turn_share: 0.05,
            position_floor_m: 0.01,
            heading_floor_rad: 0.01,
        }
    }
}

impl OdometryNoise {
    /// The motion from one odometry of a session to a later one.
    #[must_use]
    pub fn between(&self, before: &Odometry, now: &Odometry) -> RelativePose {
        let from = PlanarPose::seen_from_above(before.pose());
        let to = PlanarPose::seen_from_above(now.pose());
        let pose = from.inverse().compose(&to);
        let covariance = added(before, now, (&from, &to)).unwrap_or_else(|| self.covariance(&pose));
        RelativePose { pose, covariance }
    }

    /// A motion of which nothing else is known, seen from above.
    #[must_use]
    pub fn from_above(&self, motion: &Isometry3<f64>) -> RelativePose {
        let pose = PlanarPose::seen_from_above(motion);
        RelativePose { pose, covariance: self.covariance(&pose) }
    }

    fn covariance(&self, motion: &PlanarPose) -> Matrix3<f64> {
        let distance_m = motion.x_m().hypot(motion.y_m());
        let square = |value: f64| value * value;
        let heading = square(self.heading_floor_rad)
            + square(self.heading_rad_per_m * distance_m)
            + square(self.turn_share * motion.heading_rad());
        let along = square(self.position_floor_m) + square(self.translation_share * distance_m);
        // A heading that is wrong from half of the way on.
        let position = along + heading * square(distance_m / 2.0);
        Matrix3::from_diagonal(&Vector3::new(position, position, heading))
    }
}

/// What the robot's own covariance has grown by on the way, along the robot's own axes, if it has grown. What was wrong
/// about the heading before moves the position that the way leads to: that is not of this way, so it is taken off,
/// N = Σ' - F Σ Fᵀ with F the derivative of the pose after by the one before.
fn added(before: &Odometry, now: &Odometry, (from, to): (&PlanarPose, &PlanarPose)) -> Option<Matrix3<f64>> {
    let [x, y] = [to.x_m() - from.x_m(), to.y_m() - from.y_m()];
    let carried = Matrix3::new(1.0, 0.0, -y, 0.0, 1.0, x, 0.0, 0.0, 1.0);
    let [before, now] = [seen_from_above(before.covariance()?), seen_from_above(now.covariance()?)];
    let grown = now - carried * before * carried.transpose();
    // From the axes of odom to the robot's own.
    let turned = PlanarPose::new(0.0, 0.0, to.heading_rad()).inverse().adjoint();
    let own = turned * grown * turned.transpose();
    let own = (own + own.transpose()) * 0.5;
    let spread = own.symmetric_eigenvalues();
    (spread.max() > 0.0 && spread.min() >= -1e-7 * own.amax()).then_some(own)
}

/// Of x, y and heading.
fn seen_from_above(covariance: &Matrix6<f64>) -> Matrix3<f64> {
    const SEEN_FROM_ABOVE: [usize; 3] = [0, 1, 5];
    let of = |row, column| covariance[(SEEN_FROM_ABOVE[row], SEEN_FROM_ABOVE[column])];
    Matrix3::from_fn(|row, column| (of(row, column) + of(column, row)) * 0.5)
}

/// What a closure measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosureNoise {
    /// Of the position, in metres, above 0: half the place spacing.
    pub position_m: f64,
    /// Of the heading, in radians, above 0.
    pub heading_rad: f64,
    /// Of the heading where the camera's model is not known, in radians, above 0.
    pub heading_without_camera_rad: f64,
    /// Largest |ln s| of a view that is near enough to measure.
    pub max_ln_scale: f64,
    /// Largest |rotation| of the image, in radians.
    pub max_image_rotation_rad: f64,
    /// Largest shift of the image, in image widths, where the camera's model is not known.
    pub max_shift_without_camera_widths: f64,
}

impl ClosureNoise {
    /// Of places `spacing_m` apart.
    #[must_use]
    pub fn of_spacing(spacing_m: f64) -> Self {
        Self {
            position_m: spacing_m / 2.0,
            heading_rad: 3_f64.to_radians(),
            heading_without_camera_rad: 15_f64.to_radians(),
            max_ln_scale: 0.25,
            max_image_rotation_rad: 0.15,
            max_shift_without_camera_widths: 0.1,
        }
    }

    /// Of a robot that is at a place, but not so near to where the place was seen from that anything is measured: within
    /// some spacings of it, looking much the same way.
    #[must_use]
    pub fn somewhere(&self) -> RelativePose {
        let position_m = 4.0 * self.position_m;
        let variances = Vector3::new(position_m, position_m, 2.0 * self.heading_without_camera_rad)
            .map(|deviation| deviation * deviation);
        RelativePose { pose: PlanarPose::identity(), covariance: Matrix3::from_diagonal(&variances) }
    }

    /// The pose of the current view in the earlier one's frame, if the views are near enough to tell: at the same
    /// position, turned by the angle of the image's shift as if only rotation had moved it. Bazeille et al. 2011,
    /// section 3. `focal_length_widths` is the camera's, in image widths.
    #[must_use]
    pub fn measure(&self, view: &TwoView, focal_length_widths: Option<f64>) -> Option<RelativePose> {
        let (heading, sigma) = match view.motion? {
            Motion::Similarity(motion) => {
                let near = motion.ln_scale.abs() <= self.max_ln_scale
                    && motion.rotation_rad.abs() <= self.max_image_rotation_rad;
                let shift = motion.translation_widths[0];
                match focal_length_widths.filter(|_| near) {
                    // A robot that has turned left sees things further to the right.
                    Some(focal_length) => ((shift / focal_length).atan(), self.heading_rad),
                    None if near && shift.abs() <= self.max_shift_without_camera_widths => {
                        (0.0, self.heading_without_camera_rad)
                    }
                    None => return None,
                }
            }
            // A camera's y axis points down, so that its turn to the left is one about -y.
            Motion::Essential { rotation, .. } => {
                let matrix = rotation.to_rotation_matrix();
                (matrix[(0, 2)].atan2(matrix[(2, 2)]), self.heading_rad)
            }
            Motion::Fundamental(_) => return None,
        };
        let variances =
            Vector3::new(self.position_m, self.position_m, sigma).map(|deviation| deviation * deviation);
        let pose = PlanarPose::new(0.0, 0.0, heading);
        Some(RelativePose { pose, covariance: Matrix3::from_diagonal(&variances) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verification::Similarity;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    fn relative() -> impl Strategy<Value = RelativePose> {
        (-5.0..5.0f64, -5.0..5.0f64, -3.0..3.0f64, proptest::array::uniform9(-0.3..0.3f64)).prop_map(
            |(x, y, heading, root)| {
                let root = Matrix3::from_row_slice(&root);
                RelativePose::new(PlanarPose::new(x, y, heading), root * root.transpose()).unwrap()
            },
        )
    }

    fn close(a: &RelativePose, b: &RelativePose) -> bool {
        let apart = a.pose.inverse().compose(&b.pose);
        apart.x_m().hypot(apart.y_m()) < 1e-9
            && apart.heading_rad().abs() < 1e-9
            && (a.covariance - b.covariance).amax() < 1e-9
    }

    proptest! {
        #[test]
        fn ways_add_up_in_any_grouping(a in relative(), b in relative(), c in relative()) {
            prop_assert!(close(&a.then(&b).then(&c), &a.then(&b.then(&c))));
            prop_assert!(close(&a.back().back(), &a));
            prop_assert!(close(&a.then(&b).back(), &b.back().then(&a.back())));
            prop_assert!(close(&RelativePose::none().then(&a), &a));
        }

        /// Perturbed along their own axes, ways deviate as their covariance says.
        #[test]
        fn covariances_are_those_of_small_errors(a in relative(), b in relative(), step in proptest::array::uniform3(-1e-5..1e-5f64)) {
            let step = Vector3::from(step);
            let perturbed = a.pose.retract(&step).compose(&b.pose);
            let whole = a.pose.compose(&b.pose);
            let expected = b.pose.inverse().adjoint() * step;
            let moved = whole.inverse().compose(&perturbed);
            prop_assert!((Vector3::new(moved.x_m(), moved.y_m(), moved.heading_rad()) - expected).amax() < 1e-8);
        }

        #[test]
        fn bytes_give_the_pose_back(pose in relative()) {
            let mut writer = Writer::default();
            pose.encode(&mut writer);
            let bytes = writer.into_bytes();
            prop_assert_eq!(RelativePose::decode(&mut Reader::new(&bytes)), Ok(pose));
        }
    }

    #[test]
    fn a_pose_in_space_is_seen_from_above_along_its_own_axes() {
        let sigmas = [0.1_f64, 0.3, 9.0, 9.0, 9.0, 0.02];
        let mut covariance = [0.0; 36];
        (0..6).for_each(|axis| covariance[7 * axis] = sigmas[axis] * sigmas[axis]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let measured =
            RelativePose::measured_in_space([1.0, 2.0, 0.5], [0.0, 0.0, half, half], &covariance).unwrap();
        assert!((measured.pose.x_m() - 1.0).abs() < 1e-12 && (measured.pose.y_m() - 2.0).abs() < 1e-12);
        assert!((measured.pose.heading_rad() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        // Turned left by a quarter, it is unsure ahead as the axes are to the left.
        let own = Matrix3::from_diagonal(&Vector3::new(0.09, 0.01, 0.0004));
        assert!((measured.covariance - own).amax() < 1e-12, "{}", measured.covariance);
        let level = [0.0, 0.0, 0.0, 1.0];
        let with = |value: f64| {
            let mut wrong = covariance;
            wrong[1] = value;
            RelativePose::measured_in_space([0.0; 3], level, &wrong)
        };
        assert_eq!(with(0.01), Err(RelativePoseError::NotACovariance));
        assert_eq!(with(f64::NAN), Err(RelativePoseError::NotFinite));
        assert_eq!(with(1e13), Err(RelativePoseError::TooLarge { value: 1e13 }));
        let at = |position, orientation| RelativePose::measured_in_space(position, orientation, &covariance);
        assert_eq!(at([0.0, -1e9, 0.0], level), Err(RelativePoseError::TooLarge { value: -1e9 }));
        assert_eq!(at([0.0; 3], [0.0; 4]), Err(RelativePoseError::NotUnit { norm: 0.0 }));
        assert!(matches!(at([0.0; 3], [f64::NAN; 4]), Err(RelativePoseError::NotUnit { .. })));
    }

    #[test]
    fn what_measures_nothing_is_refused() {
        let pose = PlanarPose::identity();
        let nan = Matrix3::from_diagonal_element(f64::NAN);
        assert_eq!(RelativePose::new(pose, nan), Err(RelativePoseError::NotFinite));
        let negative = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
        assert_eq!(RelativePose::new(pose, negative), Err(RelativePoseError::NotACovariance));
    }

    /// Odometry with that covariance of x, y and heading.
    fn odometry(pose: PlanarPose, planar: Matrix3<f64>) -> Odometry {
        let mut covariance = [0.0; 36];
        for (row, &to_row) in [0, 1, 5].iter().enumerate() {
            for (column, &to_column) in [0, 1, 5].iter().enumerate() {
                covariance[6 * to_row + to_column] = planar[(row, column)];
            }
        }
        let ground = pose.on_the_ground();
        let rotation = ground.rotation.coords;
        let orientation = [rotation.x, rotation.y, rotation.z, rotation.w];
        Odometry::new([pose.x_m(), pose.y_m(), 0.0], orientation, Some(&covariance)).unwrap()
    }

    proptest! {
        /// However far the robot has come before, a step is as uncertain as it is by itself.
        #[test]
        fn the_robots_own_covariance_is_taken_apart_into_that_of_each_step(a in relative(), b in relative()) {
            let along = |pose: &PlanarPose, own: &Matrix3<f64>| {
                let turned = PlanarPose::new(0.0, 0.0, pose.heading_rad()).adjoint();
                turned * own * turned.transpose()
            };
            let floor = Matrix3::from_diagonal_element(1e-3);
            let a = RelativePose { covariance: a.covariance + floor, ..a };
            let b = RelativePose { covariance: b.covariance + floor, ..b };
            let whole = a.then(&b);
            let before = odometry(*a.pose(), along(a.pose(), a.covariance()));
            let now = odometry(*whole.pose(), along(whole.pose(), whole.covariance()));
            let step = OdometryNoise::default().between(&before, &now);
            prop_assert!(close(&step, &b), "{step:?} {b:?}");
        }
    }

    #[test]
    fn a_covariance_that_does_not_grow_says_nothing_of_a_step() {
        let noise = OdometryNoise::default();
        let at =
            |x, variance| odometry(PlanarPose::new(x, 0.0, 1.0), Matrix3::from_diagonal_element(variance));
        for (before, now) in [(0.3, 0.1), (0.1, 0.1)] {
            let step = noise.between(&at(0.0, before), &at(2.0, now));
            assert_eq!(*step.covariance(), noise.covariance(step.pose()));
        }
        let stood = noise.between(&at(0.0, 0.1), &at(0.0, 0.1));
        assert_eq!(*stood.covariance(), noise.covariance(stood.pose()));
    }

    fn shifted(shift_widths: f64, ln_scale: f64) -> TwoView {
        let motion = Similarity { rotation_rad: 0.0, ln_scale, translation_widths: [shift_widths, 0.0] };
        TwoView { matches: 50, inliers: 40, distinct_inliers: 30, motion: Some(Motion::Similarity(motion)) }
    }

    /// The paper's example: 33 pixels of 320 are 4.73 degrees, seen by a camera of 43.7 degrees.
    #[test]
    fn an_image_that_has_moved_right_was_seen_by_a_robot_that_turned_left() {
        let noise = ClosureNoise::of_spacing(0.5);
        let focal_length_widths = 33.0 / 320.0 / 4.73_f64.to_radians().tan();
        let measured = noise.measure(&shifted(33.0 / 320.0, 0.0), Some(focal_length_widths)).unwrap();
        assert!((measured.pose().heading_rad().to_degrees() - 4.73).abs() < 1e-9);
        assert!((measured.covariance()[(0, 0)].sqrt() - 0.25).abs() < 1e-12);
        assert_eq!(noise.measure(&shifted(0.0, 0.4), Some(1.0)), None, "too near or too far");
        assert_eq!(noise.measure(&shifted(0.3, 0.0), None), None, "an angle that nobody knows");
        let upright = noise.measure(&shifted(0.05, 0.0), None).unwrap();
        assert_eq!(upright.pose().heading_rad(), 0.0);
        // The same turn as a camera's own motion: things move to the right in its image.
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.2);
        let turned = rotation * Vector3::z();
        assert!(turned.x > 0.0);
        let direction = nalgebra::UnitVector3::new_normalize(Vector3::x());
        let motion = Some(Motion::Essential { rotation, direction });
        let seen = noise.measure(&TwoView { motion, ..shifted(0.0, 0.0) }, None).unwrap();
        assert!((seen.pose().heading_rad() - 0.2).abs() < 1e-12);
    }
}
