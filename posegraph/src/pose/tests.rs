use proptest::prelude::*;

use super::*;
use crate::planar::{PlanarPose, wrapped};

/// The oracle of the analytic derivatives: central differences.
fn differences<const D: usize, P: Pose<D>>(measurement: &P, from: &P, to: &P) -> Linearized<D> {
    const STEP: f64 = 1e-6;
    let [mut by_from, mut by_to] = [SMatrix::<f64, D, D>::zeros(); 2];
    for i in 0..D {
        let mut step = SVector::<f64, D>::zeros();
        step[i] = STEP;
        let slope = |error: &dyn Fn(&SVector<f64, D>) -> SVector<f64, D>| {
            (error(&step) - error(&-step)) / (2.0 * STEP)
        };
        by_from.set_column(i, &slope(&|step| P::error(measurement, &from.retract(step), to)));
        by_to.set_column(i, &slope(&|step| P::error(measurement, from, &to.retract(step))));
    }
    Linearized { error: P::error(measurement, from, to), by_from, by_to }
}

fn agree<const D: usize>(analytic: &Linearized<D>, numeric: &Linearized<D>) -> bool {
    (analytic.error - numeric.error).amax() < 1e-12
        && (analytic.by_from - numeric.by_from).amax() < 1e-6
        && (analytic.by_to - numeric.by_to).amax() < 1e-6
}

fn planar() -> impl Strategy<Value = PlanarPose> {
    (-9.0..9.0, -9.0..9.0, -3.1..3.1).prop_map(|(x, y, heading)| PlanarPose::new(x, y, heading))
}

fn spatial() -> impl Strategy<Value = Isometry3<f64>> {
    (prop::array::uniform3(-9.0..9.0), prop::array::uniform3(-1.7..1.7))
        .prop_map(|(position, axis)| Isometry3::new(Vector3::from(position), Vector3::from(axis)))
}

proptest! {
    #[test]
    fn planar_derivatives_are_what_differences_say(m in planar(), from in planar(), to in planar()) {
        // Half a turn is where the error itself jumps.
        prop_assume!(PlanarPose::error(&m, &from, &to)[2].abs() < 3.1);
        prop_assert!(agree(&PlanarPose::linearized(&m, &from, &to), &differences(&m, &from, &to)));
    }

    #[test]
    fn spatial_derivatives_are_what_differences_say(m in spatial(), from in spatial(), to in spatial()) {
        prop_assume!(Isometry3::error(&m, &from, &to).fixed_rows::<3>(3).norm() < 0.999);
        prop_assert!(agree(&Isometry3::linearized(&m, &from, &to), &differences(&m, &from, &to)));
    }

    #[test]
    fn a_step_at_a_pose_is_its_adjoint_at_the_origin(
        planar in planar(),
        spatial in spatial(),
        numbers in prop::array::uniform6(-1e-5..1e-5f64),
    ) {
        let step = SVector::from(numbers);
        let at_origin = Isometry3::identity().retract(&(spatial.adjoint() * step)).compose(&spatial);
        prop_assert!(Isometry3::error(&Isometry3::identity(), &at_origin, &spatial.retract(&step)).amax() < 1e-7);
        let step = SVector::from([numbers[0], numbers[1], numbers[2]]);
        let at_origin = PlanarPose::identity().retract(&(planar.adjoint() * step)).compose(&planar);
        prop_assert!(PlanarPose::error(&PlanarPose::identity(), &at_origin, &planar.retract(&step)).amax() < 1e-8);
    }

    #[test]
    fn an_edge_that_is_met_has_no_error(m in planar(), from in planar(), n in spatial(), start in spatial()) {
        prop_assert!(PlanarPose::error(&m, &from, &from.compose(&m)).amax() < 1e-13);
        prop_assert!(Isometry3::error(&n, &start, &start.compose(&n)).amax() < 1e-13);
        let round = from.compose(&m).compose(&m.inverse());
        prop_assert!(PlanarPose::error(&PlanarPose::identity(), &from, &round).amax() < 1e-13);
    }

    #[test]
    fn the_nearest_rotation_of_a_rotation_is_itself(planar in planar(), spatial in spatial()) {
        let again = PlanarPose::nearest(&(planar.rotation() * 3.0), &planar.position());
        prop_assert!(PlanarPose::error(&PlanarPose::identity(), &planar, &again).amax() < 1e-13);
        let again = Isometry3::nearest(&(spatial.rotation() * 3.0), &spatial.position());
        prop_assert!(Isometry3::error(&Isometry3::identity(), &spatial, &again).amax() < 1e-13);
    }

    #[test]
    fn wrapping_keeps_the_direction(angle in -100.0..100.0f64) {
        let within = wrapped(angle);
        prop_assert!(within > -PI && within <= PI);
        prop_assert!((angle.cos() - within.cos()).abs() + (angle.sin() - within.sin()).abs() < 1e-12);
        prop_assert_eq!(wrapped(within).to_bits(), within.to_bits());
    }
}

#[test]
fn errors_by_hand() {
    let origin = PlanarPose::identity();
    let ahead = PlanarPose::new(2.0, 0.0, 0.5);
    let error = PlanarPose::error(&PlanarPose::new(1.0, 0.0, PI / 2.0), &origin, &ahead);
    assert!((error - SVector::from([0.0, -1.0, 0.5 - PI / 2.0])).amax() < 1e-15);

    let turned = Isometry3::new(Vector3::new(0.0, 0.0, 3.0), Vector3::new(0.2, 0.0, 0.0));
    let error = Isometry3::error(&Isometry3::identity(), &Isometry3::identity(), &turned);
    assert!((error - SVector::from([0.0, 0.0, 3.0, 0.1f64.sin(), 0.0, 0.0])).amax() < 1e-15);
}

#[test]
fn a_planar_pose_survives_the_way_through_space() {
    let pose = PlanarPose::new(1.0, -2.0, 2.5);
    let again = PlanarPose::seen_from_above(&pose.on_the_ground());
    assert!(PlanarPose::error(&PlanarPose::identity(), &pose, &again).amax() < 1e-15);
}
