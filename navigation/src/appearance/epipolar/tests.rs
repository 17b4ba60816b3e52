use std::f64::consts::{FRAC_PI_2, PI, SQRT_2, TAU};

use nalgebra::{Isometry2, Point2, Vector2};
use proptest::prelude::*;

use super::general::GeneralMotion;
use super::*;
use crate::appearance::graph::MIN_CONSTRAINED;

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

/// The ray to a point from a robot that stands at `pose`, its camera in the origin.
fn ray(pose: &Isometry2<f64>, point: &Vector3<f64>) -> Vector3<f64> {
    let seen = pose.inverse_transform_point(&Point2::new(point.x, point.y));
    Vector3::new(seen.x, seen.y, point.z).normalize()
}

fn points(count: usize, random: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    (0..count)
        .map(|_| {
            let angle = random.random_range(0.0..TAU);
            let distance = random.random_range(1.5..5.0);
            Vector3::new(
                distance * f64::cos(angle),
                distance * f64::sin(angle),
                random.random_range(-1.0..1.5),
            )
        })
        .collect()
}

/// What both see, each ray turned at random by about `noise_rad` in each axis.
fn seen(
    current: &Isometry2<f64>,
    target: &Isometry2<f64>,
    count: usize,
    noise_rad: f64,
    seed: u64,
) -> Vec<RayPair> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let points = points(count, &mut random);
    let mut noisy = |ray: Vector3<f64>| {
        let noise = Vector3::from_fn(|_, _| random.random_range(-1.7..1.7) * noise_rad);
        (ray + noise).normalize()
    };
    points
        .iter()
        .map(|point| RayPair { current: noisy(ray(current, point)), target: noisy(ray(target, point)) })
        .collect()
}

fn with_outliers(mut pairs: Vec<RayPair>, seed: u64) -> Vec<RayPair> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let wrong: Vec<Vector3<f64>> = points(pairs.len(), &mut random);
    pairs.iter_mut().step_by(2).zip(wrong).for_each(|(pair, wrong)| pair.target = wrong.normalize());
    pairs
}

#[test]
fn known_motions_in_all_four_quadrants_are_found_with_their_rotation() {
    for quadrant in 0..4 {
        for turn in [0.0, 0.7, -1.9, 3.0] {
            // As the robot at the origin of its own axes sees the target.
            let heading = FRAC_PI_2 * f64::from(quadrant) + 0.4;
            let seen_target = Isometry2::new(Vector2::new(heading.cos(), heading.sin()) * 0.8, turn);
            let current = Isometry2::new(Vector2::new(0.3, -0.2), 1.1);
            let target = current * seen_target;
            let pairs = seen(&current, &target, 12, 0.0, 5);
            let planar = search::<PlanarMotion>(&pairs, &SearchSettings::default()).unwrap();
            assert!(wrapped(planar.motion.heading_rad() - heading).abs() < 1e-6, "{quadrant} {turn}");
            assert!(wrapped(planar.motion.rotation_rad() - turn).abs() < 1e-6, "{quadrant} {turn}");
            assert_eq!(planar.inliers.len(), 12);
            let general = search::<GeneralMotion>(&pairs, &SearchSettings::default()).unwrap();
            assert!(wrapped(general.motion.heading_rad() - heading).abs() < 1e-6, "{quadrant} {turn}");
            let yaw = general.motion.rotation() * Vector3::x();
            assert!(wrapped(yaw.y.atan2(yaw.x) - turn).abs() < 1e-6, "{quadrant} {turn}");
        }
    }
}

#[test]
fn the_essential_matrix_has_the_form_of_planar_motion() {
    let motion = PlanarMotion::new(0.6, 2.2);
    let essential = motion.essential_matrix();
    for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2)] {
        assert!(essential[(row, column)].abs() < 1e-12);
    }
    // t ∝ (e8, -e7, 0), d = -R t.
    let translation = Vector3::new(essential[(2, 1)], -essential[(2, 0)], 0.0);
    let way = -(motion.rotation() * translation);
    assert!((way - motion.direction().into_inner()).norm() < 1e-12);
    let pair = &seen(&Isometry2::identity(), &Isometry2::new(way.xy(), 0.6), 1, 0.0, 1)[0];
    assert!(pair.current.dot(&(essential * pair.target)).abs() < 1e-12);
}

#[test]
fn half_of_the_pairs_may_be_wrong() {
    let current = Isometry2::identity();
    let target = Isometry2::new(Vector2::new(-0.5, 0.9), -1.2);
    let pairs = with_outliers(seen(&current, &target, 200, 0.003, 3), 4);
    let settings = SearchSettings::default();
    let found = search::<PlanarMotion>(&pairs, &settings).unwrap();
    assert!(wrapped(found.motion.heading_rad() - 0.9_f64.atan2(-0.5)).abs() < 0.02);
    assert!(found.inliers.iter().filter(|&index| index % 2 == 1).count() >= 95);
    assert!(found.inliers.iter().filter(|&index| index % 2 == 0).count() <= 10);
    assert_eq!(search::<PlanarMotion>(&pairs, &settings), Some(found), "same seed, same answer");
}

#[test]
fn too_few_pairs_and_points_behind_a_camera_are_no_motion() {
    let current = Isometry2::identity();
    let target = Isometry2::new(Vector2::new(1.0, 0.0), 0.0);
    let pairs = seen(&current, &target, 4, 0.0, 8);
    let settings = SearchSettings::default();
    assert!(search::<PlanarMotion>(&pairs[..3], &settings).is_none());
    assert!(search::<PlanarMotion>(&pairs, &settings).is_some());
    // Two of the four seen from the other end: they meet before both for the way back alone.
    let mut crossed = pairs;
    for pair in &mut crossed[..2] {
        std::mem::swap(&mut pair.current, &mut pair.target);
    }
    assert!(search::<PlanarMotion>(&crossed, &settings).is_none());
}

/// The same from all planes through the way, one by one, and all angles in them.
fn dense_error_rad(rotation: &Rotation3<f64>, way: &Unit<Vector3<f64>>, pair: &RayPair) -> f64 {
    let x = pair.current;
    let y = rotation * pair.target;
    let aside = way.cross(&if way.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() }).normalize();
    let other = way.cross(&aside);
    let in_half_plane = |roll: f64| {
        let up = aside * roll.cos() + other * roll.sin();
        let angle = |ray: &Vector3<f64>| ray.dot(&up).atan2(ray.dot(way)).clamp(-FRAC_PI_2, PI + FRAC_PI_2);
        let nearest = |ray: &Vector3<f64>, angle: f64| {
            let on = way.into_inner() * angle.cos() + up * angle.sin();
            ray.dot(&on).clamp(-1.0, 1.0).acos()
        };
        let [a, b] = [angle(&x), angle(&y)].map(|angle| {
            if angle >= 0.0 {
                angle.min(PI)
            } else if angle > -FRAC_PI_2 {
                0.0
            } else {
                PI
            }
        });
        let (a, b) = if a <= b { (a, b) } else { ((a + b) / 2.0, (a + b) / 2.0) };
        nearest(&x, a).hypot(nearest(&y, b))
    };
    (0..20_000).map(|step| in_half_plane(TAU * f64::from(step) / 20_000.0)).fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// All around, and near the way, where there is much to get wrong.
    #[test]
    fn small_reprojection_errors_are_the_least_turns(
        [turn, heading, distance] in [-3.0..3.0f64, -3.0..3.0, 0.5..20.0],
        [aside, elevation] in prop_oneof![[-3.0..3.0f64, -0.6..0.6], [-0.05..0.05f64, -0.03..0.03]],
        noise in prop::array::uniform6(-0.02..0.02f64),
    ) {
        let motion = PlanarMotion::new(turn, heading);
        let azimuth = heading + aside;
        let point = distance * Vector3::new(azimuth.cos(), azimuth.sin(), elevation);
        let way = motion.direction();
        let rotation = motion.rotation();
        let [x, y] = [point, rotation.inverse() * (point - way.into_inner())].map(|seen| seen.normalize());
        let [dx, dy] = [Vector3::from_row_slice(&noise[..3]), Vector3::from_row_slice(&noise[3..])];
        let pair = RayPair { current: (x + dx).normalize(), target: (y + dy).normalize() };
        let found = reprojection(&rotation, &way, &pair).error_rad;
        let dense = dense_error_rad(&rotation, &way, &pair);
        // Sines for angles, and the steps of the dense one.
        prop_assert!((found - dense).abs() < 1e-3, "{found} {dense}");
    }

    /// Without noise any motion explains what is seen on it, and the way back does not.
    #[test]
    fn what_is_seen_is_before_both_cameras(turn in -3.0..3.0f64, heading in -3.0..3.0f64, seed in 0..1000u64) {
        let target = Isometry2::new(Vector2::new(heading.cos(), heading.sin()), turn);
        let motion = PlanarMotion::new(turn, heading);
        let back = PlanarMotion::new(turn, heading + PI);
        for pair in seen(&Isometry2::identity(), &target, 5, 0.0, seed) {
            prop_assert!(motion.reprojection(&pair).error_rad < 1e-6);
            let reversed = back.reprojection(&pair);
            prop_assert!(reversed.error_rad <= reversed.behind_rad / SQRT_2 + 1e-6 && reversed.behind_rad > 0.0);
        }
    }
}

/// What is matched by mistake agrees less than two views have to.
#[test]
fn wrong_pairs_hardly_agree() {
    for (count, seed) in [10, 30, 100].into_iter().flat_map(|count| (0..60).map(move |seed| (count, seed))) {
        let mut random = ChaCha8Rng::seed_from_u64(1000 * seed + count);
        let mut ray = || {
            let [azimuth, slope] = [random.random_range(-PI..PI), random.random_range(-0.78..0.78)];
            Vector3::new(azimuth.cos(), azimuth.sin(), slope).normalize()
        };
        let pairs: Vec<RayPair> = (0..count).map(|_| RayPair { current: ray(), target: ray() }).collect();
        let agreeing = search::<PlanarMotion>(&pairs, &SearchSettings::default())
            .map_or(0, |consensus| consensus.inliers.len());
        assert!(agreeing < MIN_CONSTRAINED as usize, "{agreeing} of {count}");
    }
}

/// Rotation by noise alone would be found wrong by about so much.
const TURN_TOLERANCE_RAD: f64 = 0.012;

proptest! {
    /// With half of the pairs wrong, R is that of the two poses, in sign as in size.
    #[test]
    fn a_turn_on_the_spot_is_found(from_rad in -3.1..3.1f64, to_rad in -3.1..3.1f64, seed in 0_u64..1000) {
        let [current, target] = [to_rad, from_rad].map(|heading| Isometry2::new(Vector2::new(1.0, -2.0), heading));
        let pairs = with_outliers(seen(&current, &target, 200, 0.002, seed), seed + 1);
        let found = turn(&pairs, TURN_TOLERANCE_RAD).unwrap();
        // A robot that has turned left sees what it saw further to the right.
        let error = wrapped(found.rotation_rad - (from_rad - to_rad));
        prop_assert!(error.abs() < 0.01, "{found:?}");
        prop_assert!((95..=120).contains(&found.agreeing), "{found:?}");
    }

    /// Whatever is named by a pair explains no more.
    #[test]
    fn no_turn_explains_a_way(way_rad in -3.1..3.1f64, turned_rad in -3.1..3.1f64, seed in 0_u64..1000) {
        let way = Vector2::new(way_rad.cos(), way_rad.sin()) * 0.3;
        let [current, target] = [Isometry2::new(way, turned_rad), Isometry2::identity()];
        let pairs = seen(&current, &target, 200, 0.002, seed);
        prop_assert!(turn(&pairs, TURN_TOLERANCE_RAD).unwrap().agreeing < 100);
    }
}

#[test]
fn of_no_pairs_there_is_no_turn() {
    assert_eq!(turn(&[], TURN_TOLERANCE_RAD), None);
}
