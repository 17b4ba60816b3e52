use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::mirror::{HyperbolicMirror, MirrorError, MirrorSettings};
use super::*;
use crate::features::Feature;

const SIZE_PX: (u32, u32) = (512, 128);

/// Blots of all sizes, all around: smooth, and nowhere the same. Column c lies at `turned_px` + c.
fn scenery(turned_px: u32) -> GreyImage {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let (width, height) = SIZE_PX;
    let mut light = vec![120.0_f64; (width * height) as usize];
    for _ in 0..500 {
        let [x, y] = [f64::from(width), f64::from(height)].map(|side| random.random_range(0.0..side));
        let (radius, grey) = (random.random_range(1.5..7.0_f64), random.random_range(-70.0..70.0));
        for row in 0..height {
            for column in 0..width {
                let across = (f64::from(column) - x + 256.0).rem_euclid(512.0) - 256.0;
                let squared = across * across + (f64::from(row) - y).powi(2);
                if squared < 9.0 * radius * radius {
                    light[(row * width + column) as usize] += grey * (-squared / (radius * radius)).exp();
                }
            }
        }
    }
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
    let at = |(row, column)| light[(row * width + (column + turned_px) % width) as usize];
    GreyImage::new(width, height, pixels.map(|pixel| at(pixel).clamp(0.0, 255.0) as u8).collect()).unwrap()
}

fn extractor(max_features: u32) -> Extractor {
    Extractor::new(FeatureSettings::new(Feature::RootSift, max_features, SIZE_PX.0).unwrap())
}

fn view(image: &GreyImage) -> PanoramicView {
    let camera = PanoramicCamera::new(Projection::Cylindrical, SIZE_PX).unwrap();
    PanoramicView::new(&extract(&extractor(300), image).unwrap(), &camera)
}

#[test]
fn the_middle_is_ahead_and_left_of_it_is_left() {
    for projection in [Projection::Cylindrical, Projection::Equirectangular] {
        let camera = PanoramicCamera::new(projection, (1024, 257)).unwrap();
        let close = |at: [f64; 2], x: f64, y: f64, z: f64| {
            let expected = Vector3::new(x, y, z).normalize();
            assert!((camera.ray(at) - expected).norm() < 1e-9, "{at:?}: {}", camera.ray(at));
        };
        close([511.5, 128.0], 1.0, 0.0, 0.0);
        close([255.5, 128.0], 0.0, 1.0, 0.0);
        close([-0.5, 128.0], -1.0, 0.0, 0.0);
        let up = TAU * 100.0 / 1024.0;
        let slope = if projection == Projection::Cylindrical { up } else { up.tan() };
        close([511.5, 28.0], 1.0, 0.0, slope);
    }
    assert!(PanoramicCamera::new(Projection::Equirectangular, (100, 51)).is_err());
    assert!(PanoramicCamera::new(Projection::Cylindrical, (0, 51)).is_err());
}

proptest! {
    #[test]
    fn rays_come_back_to_their_pixels(column in -0.5..1023.4f64, row in -0.5..511.5f64, is_cylinder: bool) {
        let projection = if is_cylinder { Projection::Cylindrical } else { Projection::Equirectangular };
        let camera = PanoramicCamera::new(projection, (1024, 512)).unwrap();
        prop_assume!((row - 255.5).abs() < 250.0);
        let [x, y] = camera.project(&camera.ray([column, row])).unwrap();
        prop_assert!((x - column).abs() < 1e-6 && (y - row).abs() < 1e-6);
    }
}

/// Turned by a quarter, a panorama has the same features, those across the new seam and the old one
/// among them.
#[test]
fn features_turn_with_the_panorama_across_the_seam() {
    let (straight, turned) = (view(&scenery(0)), view(&scenery(128)));
    // What was at column 128 is at column 0 now: the robot has turned right.
    let quarter = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), TAU / 4.0);
    let is_found =
        |ray: &&Vector3<f64>| turned.rays().iter().any(|other| (quarter * **ray - other).norm() < 0.01);
    let found = straight.rays().iter().filter(is_found).count();
    assert!(found * 100 >= straight.rays().len() * 97, "{found} of {}", straight.rays().len());
    // Of those within 8 columns of either seam, too.
    let columns = TAU * 8.0 / 512.0;
    let near_seam = |ray: &&Vector3<f64>| {
        let azimuth = ray.y.atan2(ray.x);
        azimuth.abs() > PI - columns || (azimuth - TAU / 4.0).abs() < columns
    };
    let near: Vec<_> = straight.rays().iter().filter(near_seam).collect();
    assert!(near.len() >= 8, "{}", near.len());
    let found = near.iter().copied().filter(|ray| is_found(ray)).count();
    assert!(found * 10 >= near.len() * 9, "{found} of {}", near.len());
    let apart = |i: usize, j: usize| {
        (straight.rays()[i] - straight.rays()[j]).norm() > 1e-6
            || straight.descriptors().rows().nth(i) != straight.descriptors().rows().nth(j)
    };
    let count = straight.rays().len();
    assert!((0..count).all(|i| (0..i).all(|j| apart(i, j))), "no feature twice");
}

#[test]
fn a_turn_on_the_spot_is_found_by_comparing() {
    let (before, after) = (view(&scenery(0)), view(&scenery(100)));
    let compared = after.compare(&before, &SearchSettings::default());
    let overlap = compared.overlap.unwrap();
    // The robot has turned right by 100 columns: the earlier one looked further to the left.
    let expected = TAU * 100.0 / 512.0;
    assert!((overlap.motion.rotation_rad() - expected).abs() < 0.01, "{overlap:?}");
    assert!(overlap.similarity() > 0.8, "{overlap:?}");
    assert_eq!(overlap.constrained as usize, compared.constrained.len());
}

/// e / a and half the focal distance of a hyperbola, and where the pinhole in its outer focus sees
/// what goes to the inner.
fn reflected_slope(eccentricity: f64, elevation: f64) -> Option<f64> {
    let (sine, cosine) = elevation.sin_cos();
    // |P - F2| - |P - F1| = 2a with a = 1: the mirror's distance from the inner focus along the ray.
    let distance = (eccentricity * eccentricity - 1.0) / (1.0 - eccentricity * sine);
    let above_pinhole = distance * sine + 2.0 * eccentricity;
    (distance > 0.0 && above_pinhole > 0.0).then(|| distance * cosine / above_pinhole)
}

#[test]
fn unwrapping_undoes_reflection_by_a_hyperboloid() {
    let (eccentricity, center, ahead): (f64, [f64; 2], f64) = (1.6, [310.3, 295.8], 0.7);
    let parameter = 2.0 * eccentricity / (1.0 + eccentricity * eccentricity);
    let horizon = 150.0;
    let px_per_slope = horizon / reflected_slope(eccentricity, 0.0).unwrap();
    let settings = MirrorSettings {
        center_px: center,
        radii_px: [30.0, 260.0],
        horizon_radius_px: horizon,
        parameter,
        ahead_rad: ahead,
    };
    let mirror = HyperbolicMirror::new(settings).unwrap();
    for elevation in [-1.2, -0.5, 0.0, 0.3, 0.6] {
        let geometric = reflected_slope(eccentricity, elevation).map(|slope| slope * px_per_slope);
        assert!((mirror.radius_px(elevation).unwrap() - geometric.unwrap()).abs() < 1e-9);
    }
    // The world by direction, and what the pinhole sees of it, pixel by pixel.
    let world = |azimuth: f64, elevation: f64| {
        128.0 + 60.0 * (3.0 * azimuth + 1.0).sin() * (4.0 * elevation).cos() + 40.0 * (5.0 * elevation).sin()
    };
    let elevation_at = |radius: f64| {
        let (mut low, mut high) = (-1.57, parameter.asin() - 1e-6);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            let is_beyond =
                reflected_slope(eccentricity, middle).is_none_or(|slope| slope * px_per_slope > radius);
            if is_beyond { high = middle } else { low = middle }
        }
        low
    };
    let pixels = (0..600 * 640).map(|pixel| {
        let (x, y) = (f64::from(pixel % 640) - center[0], center[1] - f64::from(pixel / 640));
        world(y.atan2(x) - ahead, elevation_at(x.hypot(y))) as u8
    });
    let image = GreyImage::new(640, 600, pixels.collect()).unwrap();
    let size_px = (720, 120);
    let unwrapped = mirror.unwrapped(&image, size_px).unwrap();
    let camera = HyperbolicMirror::unwrapped_camera(size_px).unwrap();
    let mut worst: f64 = 0.0;
    for (index, &grey) in (0..).zip(unwrapped.pixels()) {
        let ray = camera.ray([f64::from(index % 720), f64::from(index / 720)]);
        let elevation = ray.z.asin();
        if mirror.project(0.0, elevation).is_some() {
            worst = worst.max((world(ray.y.atan2(ray.x), elevation) - f64::from(grey)).abs());
        } else {
            assert_eq!(grey, 0);
        }
    }
    assert!(worst < 3.0, "{worst} grey values");
}

#[test]
fn numbers_that_make_no_mirror_are_refused() {
    let good = MirrorSettings {
        center_px: [100.0, 100.0],
        radii_px: [10.0, 90.0],
        horizon_radius_px: 60.0,
        parameter: 0.9,
        ahead_rad: 0.0,
    };
    assert!(HyperbolicMirror::new(good).is_ok());
    let refused = |settings| HyperbolicMirror::new(settings).unwrap_err();
    assert!(matches!(refused(MirrorSettings { radii_px: [90.0, 10.0], ..good }), MirrorError::Radii { .. }));
    assert!(matches!(
        refused(MirrorSettings { horizon_radius_px: 0.0, ..good }),
        MirrorError::Horizon { .. }
    ));
    assert!(matches!(refused(MirrorSettings { parameter: 1.0, ..good }), MirrorError::Parameter { .. }));
    assert!(matches!(refused(MirrorSettings { ahead_rad: f64::NAN, ..good }), MirrorError::Ahead { .. }));
}
