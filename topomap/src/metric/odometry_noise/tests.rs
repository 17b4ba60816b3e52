use proptest::prelude::*;

use super::super::relative_pose::tests::{close, relative};
use super::*;

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
        let a = RelativePose::known(*a.pose(), a.covariance() + floor);
        let b = RelativePose::known(*b.pose(), b.covariance() + floor);
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
    let at = |x, variance| odometry(PlanarPose::new(x, 0.0, 1.0), Matrix3::from_diagonal_element(variance));
    for (before, now) in [(0.3, 0.1), (0.1, 0.1)] {
        let step = noise.between(&at(0.0, before), &at(2.0, now));
        assert_eq!(*step.covariance(), noise.covariance(step.pose()));
    }
    let stood = noise.between(&at(0.0, 0.1), &at(0.0, 0.1));
    assert_eq!(*stood.covariance(), noise.covariance(stood.pose()));
}
