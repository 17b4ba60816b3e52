//! Which features an image has: the same from every thread, after a shift, and at every scale.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod scenes;

use std::thread;

use proptest::prelude::*;
use scenes::Disc;
use waypost_vision::features::{
    ExtractError, Extractor, Feature, FeatureError, FeatureSettings, Features, Keypoint,
};
use waypost_vision::image::{GreyImage, ImageError};

#[test]
fn every_feature_gives_what_it_promises() {
    let scene = scenes::textured(640, 480, 1);
    for feature in Feature::ALL {
        let features = extract(feature, 300, 640, &scene);
        assert_eq!(features.keypoints.len(), 300, "{feature}");
        assert_eq!(features.descriptors.len(), 300, "{feature}");
        assert_eq!(features.descriptors.kind(), feature.descriptor_kind());
        assert_eq!(features.descriptors.width(), feature.descriptor_width());
        assert!(
            features.keypoints.is_sorted_by(|a, b| a.response >= b.response),
            "{feature}: not strongest first"
        );
        for keypoint in &features.keypoints {
            assert!(
                (0.0..640.0).contains(&keypoint.x_px) && (0.0..480.0).contains(&keypoint.y_px),
                "{keypoint:?}"
            );
            assert!((0.0..=std::f32::consts::TAU).contains(&keypoint.angle_rad), "{keypoint:?}");
            assert!(keypoint.size_px > 0.0, "{keypoint:?}");
        }
    }
}

#[test]
fn fewer_features_are_the_strongest_of_many() {
    let scene = scenes::textured(320, 240, 2);
    for feature in [Feature::Sift, Feature::RootSift, Feature::UprightRootSift, Feature::Akaze] {
        let many = extract(feature, 400, 320, &scene);
        let few = extract(feature, 50, 320, &scene);
        assert_eq!(few.keypoints, many.keypoints[..50], "{feature}");
        assert_eq!(few.descriptors.as_bytes(), &many.descriptors.as_bytes()[..50 * many.descriptors.width()]);
    }
}

#[test]
fn a_blank_image_has_no_features() {
    for grey in [0, 128, 255] {
        let blank = GreyImage::new(320, 240, vec![grey; 320 * 240]).unwrap();
        for feature in Feature::ALL {
            let features = extract(feature, 500, 640, &blank);
            assert!(features.keypoints.is_empty() && features.descriptors.is_empty());
            assert_eq!(features.descriptors.width(), feature.descriptor_width());
        }
    }
}

#[test]
fn threads_agree_to_the_bit() {
    let scene = scenes::textured(480, 360, 3);
    for feature in Feature::ALL {
        let alone = bits(&extract(feature, 500, 400, &scene));
        thread::scope(|scope| {
            let workers: Vec<_> = (0..4)
                .map(|_| scope.spawn(|| [(); 3].map(|()| bits(&extract(feature, 500, 400, &scene)))))
                .collect();
            for worker in workers {
                assert!(worker.join().unwrap().iter().all(|found| *found == alone), "{feature}");
            }
        });
    }
}

#[test]
fn a_shifted_view_keeps_its_descriptors() {
    let scene = scenes::textured(700, 560, 4);
    let (right, down) = (38, 22);
    let here = scenes::crop(&scene, 0, 0, 600, 480);
    let there = scenes::crop(&scene, right, down, 600, 480);
    // Largest distance between descriptors of one point seen twice, well below that of strangers.
    for (feature, near) in [
        (Feature::Sift, 100 * 100),
        (Feature::RootSift, 100 * 100),
        (Feature::UprightRootSift, 100 * 100),
        (Feature::Orb, 64),
        (Feature::Akaze, 100),
    ] {
        let (first, second) = (extract(feature, 800, 640, &here), extract(feature, 800, 640, &there));
        let (mut in_both, mut kept) = (0, 0);
        for (index, keypoint) in first.keypoints.iter().enumerate() {
            let (x_px, y_px) = (keypoint.x_px - right as f32, keypoint.y_px - down as f32);
            if !(60.0..540.0).contains(&x_px) || !(60.0..420.0).contains(&y_px) {
                continue;
            }
            in_both += 1;
            let row = first.descriptors.row(index);
            let found_again =
                second.keypoints.iter().zip(second.descriptors.rows()).any(|(other, other_row)| {
                    (other.x_px - x_px).hypot(other.y_px - y_px) < 1.0 + 0.05 * keypoint.size_px
                        && feature.descriptor_kind().distance(row, other_row) <= near
                });
            kept += usize::from(found_again);
        }
        assert!(in_both > 200, "{feature}: only {in_both} features to compare");
        assert!(kept * 10 >= in_both * 7, "{feature}: {kept} of {in_both} found again");
    }
}

#[test]
fn root_sift_bytes_have_the_scale_as_their_length() {
    let features = extract(Feature::RootSift, 500, 640, &scenes::textured(640, 480, 5));
    for row in features.descriptors.rows() {
        let length = row.iter().map(|&byte| f64::from(byte).powi(2)).sum::<f64>().sqrt();
        assert!((length / Feature::ROOT_SIFT_SCALE - 1.0).abs() < 0.02, "length {length}");
    }
    let clipped = features.descriptors.as_bytes().iter().filter(|&&byte| byte == 255).count();
    assert_eq!(clipped, 0);
}

#[test]
fn sift_and_root_sift_look_at_the_same_points() {
    let scene = scenes::textured(320, 240, 6);
    let (sift, root_sift) =
        (extract(Feature::Sift, 200, 320, &scene), extract(Feature::RootSift, 200, 320, &scene));
    assert_eq!(sift.keypoints, root_sift.keypoints);
    assert_ne!(sift.descriptors, root_sift.descriptors);
}

/// The same points, each once, and what looks alike but for a quarter of a turn stays apart.
#[test]
fn upright_features_keep_to_the_camera() {
    let scene = scenes::textured(320, 240, 6);
    let upright = extract(Feature::UprightRootSift, 200, 320, &scene);
    assert!(upright.keypoints.iter().all(|keypoint| keypoint.angle_rad == 0.0));
    let mut places: Vec<_> =
        upright.keypoints.iter().map(|one| [one.x_px, one.y_px, one.size_px].map(f32::to_bits)).collect();
    places.sort_unstable();
    places.dedup();
    assert!(places.len() > 100 && places.len() == upright.keypoints.len(), "{} places", places.len());

    let turned: Vec<u8> = (0..320)
        .flat_map(|y| (0..240).map(move |x| (x, y)))
        .map(|(x, y)| scene.pixels()[(239 - x) * 320 + y])
        .collect();
    let turned = GreyImage::new(240, 320, turned).unwrap();
    let found_again = |feature| {
        let (first, second) = (extract(feature, 200, 320, &scene), extract(feature, 200, 320, &turned));
        let near = |row: &[u8]| {
            let distance = |other| feature.descriptor_kind().distance(row, other);
            second.descriptors.rows().any(|other| distance(other) <= 100 * 100)
        };
        first.descriptors.rows().filter(|row| near(row)).count()
    };
    let (upright, turning) = (found_again(Feature::UprightRootSift), found_again(Feature::RootSift));
    assert!(turning > 100 && upright < 20, "{turning} that turn, {upright} upright");
}

#[test]
fn keypoints_are_in_pixels_of_the_image_as_given() {
    let centres = [(200.0, 150.0), (640.0, 480.0), (1000.0, 220.0), (333.0, 777.0)];
    let discs: Vec<Disc> = centres.iter().map(|&(x, y)| Disc { x, y, radius: 20.0, grey: 250.0 }).collect();
    let image = scenes::draw(1280, 960, 60.0, &discs);
    for width in [1280, 640, 500] {
        let features = extract(Feature::Sift, 500, width, &image);
        for (x, y) in centres {
            let nearest = nearest_blob(&features.keypoints, x, y);
            let offset = f64::from(nearest.x_px - x as f32).hypot(f64::from(nearest.y_px - y as f32));
            assert!(offset < 0.15, "at {width} wide, ({x}, {y}) is off by {offset} px");
            assert!((20.0..40.0).contains(&nearest.size_px), "{nearest:?}");
        }
    }
}

#[test]
fn extraction_shrinks_as_resize_to_width_does() {
    let large = scenes::textured(1280, 720, 7);
    let small = large.resize_to_width(640).unwrap();
    for feature in Feature::ALL {
        let (from_large, from_small) =
            (extract(feature, 300, 640, &large), extract(feature, 300, 640, &small));
        assert_eq!(from_large.descriptors, from_small.descriptors);
        for (scaled, plain) in from_large.keypoints.iter().zip(&from_small.keypoints) {
            assert!((scaled.x_px - ((plain.x_px + 0.5) * 2.0 - 0.5)).abs() < 1e-3);
            assert!((scaled.y_px - ((plain.y_px + 0.5) * 2.0 - 0.5)).abs() < 1e-3);
            assert_eq!(scaled.size_px, plain.size_px * 2.0);
            assert_eq!((scaled.angle_rad, scaled.response), (plain.angle_rad, plain.response));
        }
    }
}

#[test]
fn the_width_alone_decides_up_to_four_times_as_tall() {
    let tall = scenes::textured(160, 640, 10);
    let small = tall.resize_to_width(64).unwrap();
    assert_eq!((small.width(), small.height()), (64, 256));
    let (from_tall, from_small) =
        (extract(Feature::Sift, 300, 64, &tall), extract(Feature::Sift, 300, 64, &small));
    assert!(!from_small.keypoints.is_empty());
    assert_eq!(from_tall.descriptors, from_small.descriptors);
}

#[test]
fn a_tower_of_an_image_is_shrunk_until_it_is_four_widths_tall() {
    let tower = scenes::textured(320, 8000, 11);
    let small = tower.resize_to_width(40).unwrap();
    assert_eq!((small.width(), small.height()), (40, 1000));
    let (from_tower, from_small) =
        (extract(Feature::Sift, 300, 250, &tower), extract(Feature::Sift, 300, 250, &small));
    assert!(!from_small.keypoints.is_empty());
    assert_eq!(from_tower.descriptors, from_small.descriptors);
    assert!(from_tower.keypoints.iter().all(|keypoint| keypoint.y_px < 8000.0));

    let thread = scenes::textured(16, 60_000, 12);
    let extractor = Extractor::new(FeatureSettings::new(Feature::Orb, 500, 64).unwrap());
    let error = extractor.extract(&thread).unwrap_err();
    assert_eq!(error, FeatureError::TooSmall { width: 1, height: 3750 });
    assert!(error.to_string().contains("less long and narrow"), "{error}");
}

#[test]
fn narrow_images_keep_their_size_and_tiny_ones_still_have_features() {
    let tiny = scenes::textured(160, 120, 8);
    assert_eq!(
        bits(&extract(Feature::Sift, 500, 640, &tiny)),
        bits(&extract(Feature::Sift, 500, 160, &tiny))
    );
    let found = extract(Feature::Sift, 500, 640, &tiny).keypoints.len();
    assert!(found >= 50, "{found} features");
}

#[test]
fn too_little_left_after_shrinking_is_said() {
    let ribbon = scenes::textured(2000, 40, 9);
    let extractor = Extractor::new(FeatureSettings::new(Feature::Orb, 500, 640).unwrap());
    let error = extractor.extract(&ribbon).unwrap_err();
    assert_eq!(error, FeatureError::TooSmall { width: 640, height: 13 });
    assert!(error.to_string().contains("640 x 13"));
}

#[test]
fn encoded_images_are_decoded_and_extracted() {
    let extractor = Extractor::new(FeatureSettings::default());
    let jpeg = scenes::textured(800, 600, 10).encode_jpeg(90).unwrap();
    let (image, features) = extractor.extract_encoded(&jpeg).unwrap();
    assert_eq!((image.width(), image.height()), (800, 600));
    assert_eq!(features, extractor.extract(&image).unwrap());
    assert_eq!(extractor.extract_encoded(&[]), Err(ExtractError::Image(ImageError::Empty)));
    let cut = extractor.extract_encoded(&jpeg[..jpeg.len() / 2]);
    assert_eq!(cut, Err(ExtractError::Image(ImageError::Truncated)));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_size_or_noise_makes_extraction_fail(
        feature in prop::sample::select(Feature::ALL.to_vec()),
        width in 16u32..150,
        height in 16u32..150,
        noise in prop::collection::vec(any::<u8>(), 1..50),
    ) {
        let pixels = noise.iter().copied().cycle().take((width * height) as usize).collect();
        let image = GreyImage::new(width, height, pixels).unwrap();
        let features = extract(feature, 40, 640, &image);
        prop_assert_eq!(features.keypoints.len(), features.descriptors.len());
        prop_assert!(features.keypoints.len() <= 40);
    }
}

fn extract(feature: Feature, max_features: u32, image_width: u32, image: &GreyImage) -> Features {
    let settings = FeatureSettings::new(feature, max_features, image_width).unwrap();
    Extractor::new(settings).extract(image).unwrap()
}

/// Everything in `features`, with floats as their bits.
fn bits(features: &Features) -> (Vec<[u32; 5]>, Vec<u8>) {
    let keypoints = features.keypoints.iter().map(|keypoint| {
        let Keypoint { x_px, y_px, size_px, angle_rad, response } = *keypoint;
        [x_px, y_px, size_px, angle_rad, response].map(f32::to_bits)
    });
    (keypoints.collect(), features.descriptors.as_bytes().to_vec())
}

/// The keypoint nearest to (`x`, `y`) among those as large as a blob; small ones sit on its edge.
fn nearest_blob(keypoints: &[Keypoint], x: f64, y: f64) -> Keypoint {
    let distance = |keypoint: &Keypoint| (f64::from(keypoint.x_px) - x).hypot(f64::from(keypoint.y_px) - y);
    *keypoints
        .iter()
        .filter(|keypoint| keypoint.size_px > 20.0)
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .unwrap()
}
