//! Views of known motion, with noise and wrong matches: the motion is found again.

use std::f64::consts::TAU;

use fabmap::WordId;
use fabmap::descriptor::{DescriptorKind, Descriptors};
use nalgebra::{Complex, Isometry3, Matrix3, SMatrix, UnitQuaternion, Vector3};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use rand::RngExt;
use topomap::evidence::Similarity;

use super::*;
use crate::features::Keypoint;

const SIZE_PX: (u32, u32) = (640, 480);
const SEED: u64 = 5;

fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// About normal, with standard deviation 1.
fn noise(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

fn keypoint(x_px: f64, y_px: f64, size_px: f64, angle_rad: f64) -> Keypoint {
    let angle_rad = angle_rad.rem_euclid(TAU) as f32;
    Keypoint { x_px: x_px as f32, y_px: y_px as f32, size_px: size_px as f32, angle_rad, response: 1.0 }
}

fn anywhere(random: &mut ChaCha8Rng) -> Keypoint {
    let [x, y, size, angle] = std::array::from_fn(|_| random.random::<f64>());
    keypoint(640.0 * x, 480.0 * y, 4.0 + 8.0 * size, TAU * angle)
}

/// A view whose feature `i` is word `i`, described by a row that is its own.
fn record(keypoints: Vec<Keypoint>, described: bool, disturbance: u64) -> FeatureRecord {
    let mut disturbance = random(disturbance);
    let row = |feature: usize| -> Vec<u8> {
        let mut own = random(1000 + feature as u64);
        (0..128).map(|_| own.random_range(0..100u8) + disturbance.random_range(0..10u8)).collect()
    };
    let rows: Vec<Vec<u8>> = (0..keypoints.len()).map(row).collect();
    let words = WordId::first(keypoints.len()).collect();
    let descriptors = Descriptors::new(DescriptorKind::Float, 128, rows.concat()).unwrap();
    FeatureRecord::new(SIZE_PX, keypoints, words, described.then_some(descriptors)).unwrap()
}

/// Two views of points in a plane: `inliers` moved by `motion` with a noise of 2 px, `others`
/// anywhere.
fn moved(
    motion: &Similarity,
    (inliers, others): (usize, usize),
    described: bool,
    seed: u64,
) -> (FeatureRecord, FeatureRecord) {
    let mut random = random(seed);
    let (mut earlier, mut current) = (Vec::new(), Vec::new());
    let factor = Complex::from_polar(motion.ln_scale.exp(), motion.rotation_rad);
    let shift = Complex::new(motion.translation_widths[0], motion.translation_widths[1]) * 640.0;
    let centre = Complex::new(319.5, 239.5);
    for _ in 0..inliers {
        let from = anywhere(&mut random);
        let point = Complex::new(f64::from(from.x_px), f64::from(from.y_px)) - centre;
        let to = factor * point + shift + centre;
        let (size, angle) =
            (f64::from(from.size_px) * factor.norm(), f64::from(from.angle_rad) + factor.arg());
        let (x, y) = (to.re + 2.0 * noise(&mut random), to.im + 2.0 * noise(&mut random));
        earlier.push(from);
        current.push(keypoint(x, y, size, angle));
    }
    for _ in 0..others {
        earlier.push(anywhere(&mut random));
        current.push(anywhere(&mut random));
    }
    (record(earlier, described, seed), record(current, described, seed + 1))
}

fn compare(method: VerificationMethod, earlier: &FeatureRecord, current: &FeatureRecord) -> TwoView {
    let settings = VerificationSettings { method, ..VerificationSettings::default() };
    let view = |features| View { features, camera: None };
    Verifier::new(settings, SEED).compare(view(earlier), view(current))
}

fn plane_motion(view: &TwoView) -> Similarity {
    match view.motion {
        Some(ViewMotion::Similarity(motion)) => motion,
        other => panic!("{other:?}"),
    }
}

fn similarities() -> impl Strategy<Value = Similarity> {
    (-0.4..0.4f64, -0.5..0.5f64, -0.3..0.3f64, -0.3..0.3f64).prop_map(|(rotation_rad, ln_scale, x, y)| {
        Similarity { rotation_rad, ln_scale, translation_widths: [x, y] }
    })
}

fn assert_near(found: &Similarity, expected: &Similarity, tolerance: f64) {
    let [x, y] = [0, 1].map(|axis| found.translation_widths[axis] - expected.translation_widths[axis]);
    let off = [found.rotation_rad - expected.rotation_rad, found.ln_scale - expected.ln_scale, x, y];
    assert!(off.iter().all(|off| off.abs() < tolerance), "{found:?}, not {expected:?}");
}

/// A camera with a wide view, and where it moved.
const CAMERA: Pinhole = Pinhole::ideal([400.0, 420.0], [321.0, 244.0]);

/// Two views of points in space.
fn in_space(
    motion: &Isometry3<f64>,
    (inliers, others): (usize, usize),
    noise_px: f64,
    seed: u64,
) -> (FeatureRecord, FeatureRecord) {
    let mut random = random(seed);
    let (mut earlier, mut current) = (Vec::new(), Vec::new());
    while earlier.len() < inliers {
        let [x, y, depth] = std::array::from_fn(|_| random.random::<f64>());
        let point = nalgebra::Point3::new(8.0 * x - 4.0, 6.0 * y - 3.0, 2.0 + 6.0 * depth);
        let mut pixel = |point: nalgebra::Point3<f64>| {
            let at = |axis: usize| CAMERA.focal_px[axis] * point[axis] / point.z + CAMERA.center_px[axis];
            keypoint(at(0) + noise_px * noise(&mut random), at(1) + noise_px * noise(&mut random), 8.0, 1.0)
        };
        let (from, to) = (pixel(point), pixel(motion * point));
        let inside = |k: &Keypoint| (0.0..640.0).contains(&k.x_px) && (0.0..480.0).contains(&k.y_px);
        if (motion * point).z > 0.5 && inside(&from) && inside(&to) {
            earlier.push(from);
            current.push(to);
        }
    }
    for _ in 0..others {
        let still = |random: &mut ChaCha8Rng| Keypoint { angle_rad: 1.0, size_px: 8.0, ..anywhere(random) };
        earlier.push(still(&mut random));
        current.push(still(&mut random));
    }
    (record(earlier, true, seed), record(current, true, seed + 1))
}

fn motions_in_space() -> impl Strategy<Value = Isometry3<f64>> {
    ([-0.2..0.2f64, -0.3..0.3, -0.2..0.2], [-1.0..1.0f64, -0.4..0.4, -1.0..1.0])
        .prop_filter("a step that can be seen", |(_, step)| step[0].abs() > 0.3)
        .prop_map(|([a, b, c], [x, y, z])| {
            Isometry3::from_parts(Vector3::new(x, y, z).into(), UnitQuaternion::from_euler_angles(a, b, c))
        })
}

/// Of a few motions another one, near by, explains nearly as much, so this is about how many are
/// found.
#[test]
fn motions_in_space_are_found_with_known_intrinsics() {
    const MOTIONS: usize = 2000;
    let method = VerificationMethod::Epipolar;
    let verifier = Verifier::new(VerificationSettings { method, ..VerificationSettings::default() }, SEED);
    let strategy = (motions_in_space(), 0..30usize, any::<u32>());
    let mut runner = TestRunner::deterministic();
    let mut missed = 0;
    for _ in 0..MOTIONS {
        let (motion, others, seed) = strategy.new_tree(&mut runner).unwrap().current();
        let (earlier, current) = in_space(&motion, (90, others), 0.5, u64::from(seed));
        let view = |features| View { features, camera: Some(RobotCamera::ahead(CAMERA)) };
        let found = verifier.compare(view(&earlier), view(&current));
        let Some(ViewMotion::Essential { rotation, direction }) = found.motion else { panic!("{found:?}") };
        let turned = rotation.angle_to(&motion.rotation);
        let aside = direction.dot(&motion.translation.vector.normalize()).clamp(-1.0, 1.0).acos();
        missed += usize::from(found.inliers < 80 || turned >= 0.05 || aside >= 0.3);
    }
    assert!(missed * 200 <= MOTIONS, "{missed} of {MOTIONS} are not found");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_motion_in_the_plane_is_found_among_wrong_matches(
        motion in similarities(), inliers in 30..150usize, others in 0..60usize, described in any::<bool>(), seed in any::<u32>(),
    ) {
        let (earlier, current) = moved(&motion, (inliers, others), described, u64::from(seed));
        let view = compare(VerificationMethod::Similarity, &earlier, &current);
        prop_assert!(view.inliers as usize >= inliers * 9 / 10, "{view:?}");
        prop_assert!(view.distinct_inliers == view.inliers && view.inliers <= view.matches);
        assert_near(&plane_motion(&view), &motion, 0.08);
        prop_assert_eq!(compare(VerificationMethod::Similarity, &earlier, &current), view);
    }

    #[test]
    fn swapped_views_give_the_inverse(motion in similarities(), others in 0..30usize, seed in any::<u32>()) {
        let (earlier, current) = moved(&motion, (80, others), true, u64::from(seed));
        let there = plane_motion(&compare(VerificationMethod::Similarity, &earlier, &current));
        let back = plane_motion(&compare(VerificationMethod::Similarity, &current, &earlier));
        let factor = Complex::from_polar(there.ln_scale.exp(), there.rotation_rad).inv();
        let shift = -factor * Complex::new(there.translation_widths[0], there.translation_widths[1]);
        let inverse = Similarity {
            rotation_rad: factor.arg(), ln_scale: factor.norm().ln(), translation_widths: [shift.re, shift.im],
        };
        assert_near(&back, &inverse, 0.03);
    }

    /// The refit against the same least squares by a dense solver, for the scale that one view
    /// alone would give: the symmetric one is its geometric mean with that of the swapped views.
    #[test]
    fn the_refit_is_least_squares(motion in similarities(), seed in any::<u32>()) {
        let (earlier, current) = moved(&motion, (40, 0), true, u64::from(seed));
        let view = |features| View { features, camera: None };
        let matches = crate::matching::matches(&earlier, &current);
        let pairs = in_widths(&matches, view(&earlier), view(&current));
        let dense = |from: fn(&Correspondence) -> Complex<f64>, to: fn(&Correspondence) -> Complex<f64>| {
            let mut normal = SMatrix::<f64, 4, 4>::zeros();
            let mut right = SMatrix::<f64, 4, 1>::zeros();
            for pair in &pairs {
                let (x, y) = (from(pair), to(pair));
                for (row, value) in [([x.re, -x.im, 1.0, 0.0], y.re), ([x.im, x.re, 0.0, 1.0], y.im)] {
                    let row = SMatrix::<f64, 4, 1>::from_row_slice(&row);
                    normal += row * row.transpose();
                    right += row * value;
                }
            }
            let solution = normal.lu().solve(&right).unwrap();
            Complex::new(solution[0], solution[1])
        };
        let there = dense(|pair| pair.earlier, |pair| pair.current);
        let back = dense(|pair| pair.current, |pair| pair.earlier);
        let fitted = similarity::PlaneMotion::fit(&pairs).unwrap().as_similarity();
        prop_assert!((fitted.rotation_rad - there.arg()).abs() < 1e-9);
        prop_assert!((fitted.ln_scale - (there.norm() / back.norm()).sqrt().ln()).abs() < 1e-9);
    }

    #[test]
    fn wrong_matches_alone_are_no_motion(count in 0..120usize, seed in any::<u32>()) {
        let none = Similarity { rotation_rad: 0.0, ln_scale: 0.0, translation_widths: [0.0, 0.0] };
        let (earlier, current) = moved(&none, (0, count), true, u64::from(seed));
        let view = compare(VerificationMethod::Similarity, &earlier, &current);
        prop_assert!(view.inliers < VerificationSettings::default().min_inliers, "{view:?}");
        prop_assert!((view.matches as usize) < count / 2 + 10, "keypoints that turn at random are left out");
    }

    /// A camera that stands still, or only turns, leaves open where it went: no reason to see
    /// another scene.
    #[test]
    fn views_without_a_step_are_of_one_scene(turn_rad in 0.0..0.2f64, noise_px in 0.0..0.6f64, still in any::<bool>(), others in 0..30usize, seed in any::<u32>()) {
        let turn = if still { 0.0 } else { turn_rad };
        let motion = Isometry3::rotation(Vector3::new(0.0, turn, 0.0));
        let (earlier, current) = in_space(&motion, (90, others), noise_px, u64::from(seed));
        let settings = VerificationSettings { method: VerificationMethod::Epipolar, ..VerificationSettings::default() };
        for camera in [None, Some(RobotCamera::ahead(CAMERA))] {
            let view = |features| View { features, camera };
            let found = Verifier::new(settings, SEED).compare(view(&earlier), view(&current));
            prop_assert!(found.inliers >= 80, "{found:?}");
            if let Some(ViewMotion::Essential { rotation, .. }) = found.motion {
                prop_assert!(rotation.angle_to(&motion.rotation) < 0.05, "{found:?}");
            }
        }
    }

    #[test]
    fn a_view_agrees_with_itself(seed in any::<u32>()) {
        let (view, _) = in_space(&Isometry3::identity(), (90, 0), 0.0, u64::from(seed));
        let settings = VerificationSettings { method: VerificationMethod::Epipolar, ..VerificationSettings::default() };
        for camera in [None, Some(RobotCamera::ahead(CAMERA))] {
            let seen = View { features: &view, camera };
            let found = Verifier::new(settings, SEED).compare(seen, seen);
            prop_assert_eq!(found.inliers, 90);
            if let Some(ViewMotion::Essential { rotation, .. }) = found.motion {
                prop_assert!(rotation.angle() < 0.01, "{found:?}");
            }
        }
    }

    /// Through a lens that bends rays, with what is known of it, the same motion is found.
    #[test]
    fn a_known_lens_is_seen_through(motion in motions_in_space(), k1 in -0.2..0.2f64, p1 in -0.002..0.002f64, seed in any::<u32>()) {
        let (earlier, current) = in_space(&motion, (90, 10), 0.3, u64::from(seed));
        let distortion = Distortion { radial: [k1, 0.02, 0.0], tangential: [p1, 0.001] };
        let bent = |view: &FeatureRecord| {
            let keypoints = view.keypoints().iter().map(|at| {
                let to = distortion.apply(CAMERA.ray(at));
                let [x, y] = [to.re * CAMERA.focal_px[0] + CAMERA.center_px[0], to.im * CAMERA.focal_px[1] + CAMERA.center_px[1]];
                Keypoint { x_px: x as f32, y_px: y as f32, ..*at }
            });
            FeatureRecord::new(SIZE_PX, keypoints.collect(), view.words().to_vec(), view.descriptors().cloned()).unwrap()
        };
        let (earlier, current) = (bent(&earlier), bent(&current));
        let settings = VerificationSettings { method: VerificationMethod::Epipolar, ..VerificationSettings::default() };
        let view = |features| View { features, camera: Some(RobotCamera::ahead(Pinhole { distortion, ..CAMERA })) };
        let found = Verifier::new(settings, SEED).compare(view(&earlier), view(&current));
        let Some(ViewMotion::Essential { rotation, .. }) = found.motion else { panic!("{found:?}") };
        prop_assert!(found.inliers >= 80 && rotation.angle_to(&motion.rotation) < 0.05, "{found:?}");
    }

    /// Every inlier obeys x'ᵀ F x = 0, evaluated plainly, to first order within the tolerance; F
    /// has rank 2.
    #[test]
    fn a_fundamental_matrix_is_found_without(motion in motions_in_space(), others in 0..30usize, seed in any::<u32>()) {
        let (earlier, current) = in_space(&motion, (90, others), 0.5, u64::from(seed));
        let found = compare(VerificationMethod::Epipolar, &earlier, &current);
        let Some(ViewMotion::Fundamental(rows)) = found.motion else { panic!("{found:?}") };
        let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
        prop_assert!((matrix.norm() - 1.0).abs() < 1e-9 && matrix.determinant().abs() < 1e-9);
        let point = |keypoint: &Keypoint| {
            Vector3::new((f64::from(keypoint.x_px) - 319.5) / 640.0, (f64::from(keypoint.y_px) - 239.5) / 640.0, 1.0)
        };
        let obeying = earlier.keypoints()[..90].iter().zip(&current.keypoints()[..90]).filter(|(from, to)| {
            let (x, y) = (point(from), point(to));
            let (line, back) = (matrix * x, matrix.transpose() * y);
            let distance = (y.transpose() * matrix * x)[0].abs()
                / (line.x.powi(2) + line.y.powi(2) + back.x.powi(2) + back.y.powi(2)).sqrt();
            distance <= epipolar::TOLERANCE_WIDTHS
        });
        prop_assert!(obeying.count() >= 70, "{found:?}");
    }

    /// Whatever a robot sends, the answer is finite or none.
    #[test]
    fn any_keypoints_are_borne(values in proptest::collection::vec(any::<[f32; 4]>(), 0..20), method in 0..2usize) {
        let odd = |[x_px, y_px, size_px, angle_rad]: &[f32; 4]| {
            Keypoint { x_px: *x_px, y_px: *y_px, size_px: *size_px, angle_rad: *angle_rad, response: 0.0 }
        };
        let features = record(values.iter().map(odd).collect(), true, 1);
        let method = [VerificationMethod::Similarity, VerificationMethod::Epipolar][method];
        let view = compare(method, &features, &features);
        let lens = Distortion { radial: [-0.3, 0.1, 0.0], tangential: [0.001; 2] };
        let settings = VerificationSettings { method, ..VerificationSettings::default() };
        let seen = View { features: &features, camera: Some(RobotCamera::ahead(Pinhole { distortion: lens, ..CAMERA })) };
        let through_lens = Verifier::new(settings, SEED).compare(seen, seen);
        if let Some(ViewMotion::Essential { rotation, direction }) = through_lens.motion {
            prop_assert!(rotation.coords.iter().chain(direction.iter()).all(|value| value.is_finite()));
        }
        if let Some(ViewMotion::Similarity(motion)) = view.motion {
            prop_assert!(motion.rotation_rad.is_finite() && motion.ln_scale.is_finite());
            prop_assert!(motion.translation_length_widths().is_finite());
        }
    }
}

#[test]
fn no_method_finds_no_motion() {
    let none = Similarity { rotation_rad: 0.0, ln_scale: 0.0, translation_widths: [0.0, 0.0] };
    let (earlier, current) = moved(&none, (50, 0), true, 3);
    let view = compare(VerificationMethod::None, &earlier, &current);
    assert_eq!((view.motion, view.inliers), (None, 0));
}
