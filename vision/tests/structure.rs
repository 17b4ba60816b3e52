//! Features get depths from the way that a robot drove, and say where it is when it sees them again.

#![expect(clippy::unwrap_used, reason = "a helper of a test that unwraps fails it")]

use std::sync::Arc;

use fabmap::WordId;
use fabmap::descriptor::{DescriptorKind, Descriptors};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use posegraph::{PlanarPose, Pose};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{Placement, VerificationSettings};
use topomap::metric::{Agreement, AgreementVerdict, Odometry, OdometryNoise, RelativePose};
use waypost_vision::structure::{RobotCamera, Tracker};
use waypost_vision::{FeatureRecord, Keypoint, Pinhole, Verifier, View};

const SIZE_PX: (u32, u32) = (320, 240);

/// A camera of 70 degrees, ahead of the robot's middle, to its left, turned and tilted a little.
fn camera() -> RobotCamera {
    let rotation = UnitQuaternion::from_euler_angles(0.02, -0.05, 0.1);
    let base_to_camera = Isometry3::from_parts(Translation3::new(0.15, 0.05, 0.6), rotation);
    RobotCamera { pinhole: Pinhole::of_field_of_view(70_f64.to_radians(), SIZE_PX), base_to_camera }
}

/// Landmarks on the walls of a room of 8 x 6 m, each with a look of its own.
struct Room {
    landmarks: Vec<(Vector3<f64>, [u8; 32])>,
}

impl Room {
    fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let landmark = |_| {
            let height = random.random_range(0.1..2.5);
            let along = random.random_range(0.0..1.0);
            let point = match random.random_range(0..4) {
                0 => Vector3::new(8.0 * along, -3.0, height),
                1 => Vector3::new(8.0 * along, 3.0, height),
                2 => Vector3::new(8.0, 6.0 * along - 3.0, height),
                _ => Vector3::new(-1.0, 6.0 * along - 3.0, height),
            };
            let mut look = [0; 32];
            random.fill_bytes(&mut look);
            (point, look)
        };
        Self { landmarks: (0..900).map(landmark).collect() }
    }

    /// What a robot sees, with half a pixel of noise, if it is rolled and pitched so far.
    fn seen(&self, robot: &PlanarPose, [roll, pitch]: [f64; 2], random: &mut ChaCha8Rng) -> FeatureRecord {
        let camera = camera();
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, robot.heading_rad());
        let base = Isometry3::from_parts(Translation3::new(robot.x_m(), robot.y_m(), 0.0), turn);
        let pose = base * camera.base_to_camera;
        let (mut keypoints, mut looks) = (Vec::new(), Vec::new());
        for (landmark, look) in &self.landmarks {
            let seen = pose.inverse_transform_point(&Point3::from(*landmark));
            let Pinhole { focal_px, center_px, .. } = camera.pinhole;
            let x_px = center_px[0] - focal_px[0] * seen.y / seen.x + random.random_range(-0.5..0.5);
            let y_px = center_px[1] - focal_px[1] * seen.z / seen.x + random.random_range(-0.5..0.5);
            let inside = (0.0..320.0).contains(&x_px) && (0.0..240.0).contains(&y_px);
            if seen.x > 0.2 && inside {
                let at = Keypoint {
                    x_px: x_px as f32,
                    y_px: y_px as f32,
                    size_px: 31.0,
                    angle_rad: 0.0,
                    response: 1.0,
                };
                keypoints.push(at);
                looks.extend_from_slice(look);
            }
        }
        let words = vec![WordId::default(); keypoints.len()];
        let descriptors = Descriptors::new(DescriptorKind::Binary, 32, looks).unwrap();
        FeatureRecord::new(SIZE_PX, keypoints, words, Some(descriptors)).unwrap()
    }
}

fn odometry(pose: &PlanarPose) -> Odometry {
    let half = pose.heading_rad() / 2.0;
    Odometry::new([pose.x_m(), pose.y_m(), 0.0], [0.0, 0.0, half.sin(), half.cos()], None).unwrap()
}

/// A drive in steps, by wheels that take `scale` of a metre for one and turn by `drift` radians a metre.
fn drive(room: &Room, poses: &[PlanarPose], wheels: [f64; 2], seed: u64) -> Vec<Arc<FeatureRecord>> {
    nodding(room, poses, wheels, 0.0, seed)
}

/// The same by a robot that is tilted by up to `most_rad` whichever way, at each image anew.
fn nodding(
    room: &Room,
    poses: &[PlanarPose],
    [scale, drift]: [f64; 2],
    most_rad: f64,
    seed: u64,
) -> Vec<Arc<FeatureRecord>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut tracker = Tracker::new(OdometryNoise::default());
    let mut wheels = PlanarPose::identity();
    let mut before = poses[0];
    poses
        .iter()
        .map(|pose| {
            let step = before.inverse().compose(pose);
            let way_m = step.x_m().hypot(step.y_m());
            let heading = step.heading_rad() + drift * way_m;
            wheels = wheels.compose(&PlanarPose::new(scale * step.x_m(), scale * step.y_m(), heading));
            before = *pose;
            let tilt = [0; 2].map(|_| most_rad * random.random_range(-1.0..1.0));
            let features = Arc::new(room.seen(pose, tilt, &mut random));
            tracker.track(features, Some(&camera()), Some(&odometry(&wheels)))
        })
        .collect()
}

fn straight(from: PlanarPose, step_m: f64, steps: usize) -> Vec<PlanarPose> {
    (0..=steps).map(|step| from.compose(&PlanarPose::new(step_m * step as f64, 0.0, 0.0))).collect()
}

fn placement(earlier: &FeatureRecord, current: &FeatureRecord) -> Placement {
    let verifier = Verifier::new(VerificationSettings::default(), 0);
    let view = |features| View { features, camera: Some(camera()) };
    verifier.compare(view(earlier), view(current)).placement
}

fn at(placement: Placement) -> RelativePose {
    match placement {
        Placement::At { pose, inliers } => {
            assert!(inliers >= 12, "{inliers} inliers");
            pose
        }
        Placement::Nowhere | Placement::Unknown => panic!("{placement:?}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// A robot that comes back near the end of its way is measured to centimetres, and within what it says itself;
    /// whether the depths are those of the way, of the way back, or of both.
    #[test]
    fn a_robot_that_returns_is_measured(
        seed in 0..1000u64, ahead in -0.4..0.9f64, aside in -0.5..0.5f64, turned in -0.3..0.3f64,
        scale in 0.98..1.02f64, drift in -0.05..0.05f64,
    ) {
        let room = Room::new(seed);
        let taught = drive(&room, &straight(PlanarPose::identity(), 0.4, 5), [scale, drift], seed);
        let place = PlanarPose::new(2.0, 0.0, 0.0);
        let back = place.compose(&PlanarPose::new(ahead, aside, turned));
        let start = back.compose(&PlanarPose::new(-1.6, 0.0, 0.0));
        let again = drive(&room, &straight(start, 0.4, 4), [scale, drift], seed + 1);
        let lost = drive(&room, &[back], [1.0, 0.0], seed + 2);
        let truth = place.inverse().compose(&back);
        for current in [&again[4], &lost[0]] {
            let measured = at(placement(&taught[5], current));
            let off = PlanarPose::error(measured.pose(), &PlanarPose::identity(), &truth);
            prop_assert!(off.x.hypot(off.y) < 0.2 && off.z.abs() < 0.05, "off by {off:?} at {truth:?}");
            let squared = off.dot(&(measured.information() * off));
            prop_assert!(squared < 80.0, "{squared} squared deviations off");
        }
        // The first frame of the taught way has no depths: those of the way back are enough, if coarser after 40 cm.
        let behind = taught[0].clone();
        prop_assert_eq!(behind.structure().known(), 0);
        let measured = at(placement(&behind, &drive(&room, &straight(start, 0.2, 4), [1.0, 0.0], seed)[2]));
        let truth = start.compose(&PlanarPose::new(0.4, 0.0, 0.0));
        let off = PlanarPose::error(measured.pose(), &PlanarPose::identity(), &truth);
        prop_assert!(off.x.hypot(off.y) < 0.6, "off by {off:?} at {truth:?}");
    }

    /// Images every few centimetres say as much as those every half metre.
    #[test]
    fn many_images_say_no_less(seed in 0..1000u64) {
        let room = Room::new(seed);
        let taught = drive(&room, &straight(PlanarPose::identity(), 0.05, 40), [1.0, 0.0], seed);
        let known = taught[40].structure().known();
        prop_assert!(known > 50, "{known} depths");
        let back = drive(&room, &[PlanarPose::new(2.3, 0.2, 0.1)], [1.0, 0.0], seed + 1);
        let measured = at(placement(&taught[40], &back[0]));
        let off = PlanarPose::error(measured.pose(), &PlanarPose::identity(), &PlanarPose::new(0.3, 0.2, 0.1));
        prop_assert!(off.x.hypot(off.y) < 0.2, "off by {off:?}");
    }
}

/// How far off what was measured is, in metres, and in squared deviations of its own.
fn off(measured: &RelativePose, truth: &PlanarPose) -> (f64, f64) {
    let off = PlanarPose::error(measured.pose(), &PlanarPose::identity(), truth);
    (off.x.hypot(off.y), off.dot(&(measured.information() * off)))
}

/// Two hundred returns that are always the same, by robots that are tilted by up to that: how far off
/// they are in the median and in 95 %, in metres, and how many lie within their own 95 %.
fn returns(most_tilt_rad: f64) -> ([f64; 2], usize) {
    let mut random = ChaCha8Rng::seed_from_u64(20);
    let mut offs = Vec::new();
    for seed in 0..200 {
        let mut within = |least: f64, most: f64| random.random_range(least..most);
        let wheels = [within(0.98, 1.02), within(-0.05, 0.05)];
        let room = Room::new(seed);
        let taught = nodding(&room, &straight(PlanarPose::identity(), 0.4, 5), wheels, most_tilt_rad, seed);
        let truth = PlanarPose::new(within(-0.4, 0.9), within(-0.5, 0.5), within(-0.3, 0.3));
        let back = PlanarPose::new(2.0, 0.0, 0.0).compose(&truth);
        let way_back = straight(back.compose(&PlanarPose::new(-1.6, 0.0, 0.0)), 0.4, 4);
        let again = nodding(&room, &way_back, wheels, most_tilt_rad, seed + 1);
        offs.push(off(&at(placement(&taught[5], &again[4])), &truth));
    }
    let mut metres: Vec<f64> = offs.iter().map(|(metres, _)| *metres).collect();
    metres.sort_by(f64::total_cmp);
    // Three degrees of freedom: 95 of 100 lie within 7.81 squared deviations.
    let within_own = offs.iter().filter(|(_, squared)| *squared <= 7.81).count();
    ([metres[100], metres[190]], within_own)
}

#[test]
fn most_returns_are_measured_to_centimetres() {
    let ([median_m, most_m], within_own) = returns(0.0);
    assert!(median_m < 0.015 && most_m < 0.05, "{median_m} m in the median, 95 % within {most_m} m");
    assert!(within_own >= 180, "{within_own} of 200 within their own 95 %");
}

/// Robots nod when they brake, and floors are not even: a degree either way is taken for what
/// it is, not for a way.
#[test]
fn a_robot_that_nods_is_measured_as_well() {
    let ([median_m, most_m], within_own) = returns(1_f64.to_radians());
    assert!(median_m < 0.03 && most_m < 0.1, "{median_m} m in the median, 95 % within {most_m} m");
    assert!(within_own >= 170, "{within_own} of 200 within their own 95 %");
}

#[test]
fn another_room_is_nowhere() {
    let taught = drive(&Room::new(1), &straight(PlanarPose::identity(), 0.4, 5), [1.0, 0.0], 1);
    let other = drive(&Room::new(2), &straight(PlanarPose::identity(), 0.4, 5), [1.0, 0.0], 1);
    assert_eq!(placement(&taught[5], &other[5]), Placement::Nowhere);
}

#[test]
fn without_parallax_nothing_is_said() {
    let turning: Vec<PlanarPose> =
        (0..6).map(|step| PlanarPose::new(0.0, 0.0, 0.1 * f64::from(step))).collect();
    let standing = vec![PlanarPose::identity(); 4];
    for poses in [turning, standing] {
        // The camera sits beside the middle, so that a turn moves it a little: too little for depths that tell.
        let frames = drive(&Room::new(3), &poses, [1.0, 0.0], 1);
        let last = frames.last().unwrap();
        assert!(!matches!(placement(last, last), Placement::Nowhere));
        let standing = drive(&Room::new(3), &[poses[0]], [1.0, 0.0], 2);
        assert_eq!(placement(&standing[0], &standing[0]), Placement::Unknown);
    }
}

#[test]
fn without_odometry_or_camera_nothing_is_known() {
    let room = Room::new(4);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut tracker = Tracker::new(OdometryNoise::default());
    let poses = straight(PlanarPose::identity(), 0.4, 3);
    let [first, second, third, fourth] =
        [0, 1, 2, 3].map(|index| Arc::new(room.seen(&poses[index], [0.0; 2], &mut random)));
    let camera = camera();
    tracker.track(first, Some(&camera), Some(&odometry(&poses[0])));
    let known = tracker.track(second, Some(&camera), Some(&odometry(&poses[1])));
    assert!(known.structure().known() > 50);
    assert_eq!(tracker.track(third, Some(&camera), None).structure().known(), 0);
    assert_eq!(tracker.track(fourth, None, Some(&odometry(&poses[3]))).structure().known(), 0);
}

/// What is found of the turns of a robot that sees by a camera of 70 degrees, of which another is declared,
/// and whose wheels say so many times the turn.
fn turning(
    poses: &[PlanarPose],
    declared_degrees: f64,
    wheels_turn: f64,
    late_frames: usize,
) -> Option<Agreement> {
    let room = Room::new(8);
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let declared = Pinhole::of_field_of_view(declared_degrees.to_radians(), SIZE_PX);
    let declared = RobotCamera { pinhole: declared, ..camera() };
    let mut tracker = Tracker::new(OdometryNoise::default());
    let mut wheels = vec![PlanarPose::identity()];
    for pair in poses.windows(2) {
        let step = pair[0].inverse().compose(&pair[1]);
        let step = PlanarPose::new(step.x_m(), step.y_m(), step.heading_rad() * wheels_turn);
        wheels.push(wheels[wheels.len() - 1].compose(&step));
    }
    for index in late_frames..poses.len() {
        let features = Arc::new(room.seen(&poses[index], [0.0; 2], &mut random));
        tracker.track(features, Some(&declared), Some(&odometry(&wheels[index - late_frames])));
    }
    tracker.turning()
}

/// A way in bends: so much ahead at each image, and to the left or to the right by turns.
fn bends(step_m: f64, turn_rad: f64, images_a_bend: usize) -> Vec<PlanarPose> {
    let mut pose = PlanarPose::new(1.0, 0.0, 0.0);
    let mut poses = vec![pose];
    for image in 0..36_usize {
        let left = (image / images_a_bend).is_multiple_of(2);
        pose = pose.compose(&PlanarPose::new(step_m, 0.0, if left { turn_rad } else { -turn_rad }));
        poses.push(pose);
    }
    poses
}

/// On bends and on the spot.
const WAYS: [(f64, f64); 2] = [(0.1, 0.15), (0.0, 0.15)];

#[test]
fn a_camera_as_declared_turns_as_wheels_do() {
    for (step_m, turn_rad) in WAYS {
        let found = turning(&bends(step_m, turn_rad, 5), 70.0, 1.0, 0).unwrap();
        assert!(found.compared >= 20 && (found.ratio - 1.0).abs() < 0.05, "{found:?}");
        assert_eq!(found.verdict(), AgreementVerdict::Alike);
    }
}

/// An image of a wider field of view seems to turn less: by the ratio of the focal lengths.
#[test]
fn another_field_of_view_shows_in_turns() {
    for (step_m, turn_rad) in WAYS {
        for declared_degrees in [50.0_f64, 95.0] {
            let tangent = |degrees: f64| (degrees.to_radians() / 2.0).tan();
            let truly = tangent(declared_degrees) / tangent(70.0);
            let found = turning(&bends(step_m, turn_rad, 5), declared_degrees, 1.0, 0).unwrap();
            assert!((found.ratio / truly - 1.0).abs() < 0.1, "{truly}: {found:?}");
            assert_eq!(found.verdict(), AgreementVerdict::OfAnotherScale);
        }
        let found = turning(&bends(step_m, turn_rad, 5), 70.0, 1.4, 0).unwrap();
        assert!((found.ratio * 1.4 - 1.0).abs() < 0.1, "{found:?}");
    }
}

/// Odometry that is an image or two late leads around other bends than the images.
#[test]
fn odometry_out_of_step_with_images_shows_in_turns() {
    for (step_m, turn_rad) in WAYS {
        let found = turning(&bends(step_m, turn_rad, 2), 70.0, 1.0, 1).unwrap();
        assert_eq!(found.verdict(), AgreementVerdict::OutOfStep, "{found:?}");
    }
}

#[test]
fn a_way_without_turns_says_nothing_of_them() {
    assert_eq!(turning(&straight(PlanarPose::identity(), 0.2, 30), 70.0, 1.0, 0), None);
}
