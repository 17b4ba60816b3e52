use super::*;
use proptest::prelude::*;

pub(crate) fn relative() -> impl Strategy<Value = RelativePose> {
    (-5.0..5.0f64, -5.0..5.0f64, -3.0..3.0f64, proptest::array::uniform9(-0.3..0.3f64)).prop_map(
        |(x, y, heading, root)| {
            let root = Matrix3::from_row_slice(&root);
            RelativePose::new(PlanarPose::new(x, y, heading), root * root.transpose()).unwrap()
        },
    )
}

pub(crate) fn close(a: &RelativePose, b: &RelativePose) -> bool {
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
