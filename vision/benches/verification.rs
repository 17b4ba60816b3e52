//! One candidate at 500 keypoints: matching and RANSAC.
//!
//! `cargo bench -p waypost-vision --bench verification`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use fabmap::WordId;
use fabmap::descriptor::{DescriptorKind, Descriptors};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{VerificationMethod, VerificationSettings};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Keypoint;
use waypost_vision::structure::RobotCamera;
use waypost_vision::verification::{Pinhole, Verifier, View};

const FEATURES: usize = 500;

/// Features that are the same in both views; real views share fewer.
const SHARED: usize = 150;

/// Two views of one scene, the second a little aside.
fn views() -> [FeatureRecord; 2] {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut views = [(Vec::new(), Vec::new(), Vec::new()), (Vec::new(), Vec::new(), Vec::new())];
    for feature in 0..FEATURES {
        let shared = feature < SHARED;
        let [mut x_px, mut y_px]: [f32; 2] =
            [random.random_range(0.0..640.0), random.random_range(0.0..480.0)];
        let mut row: Vec<u8> = (0..128).map(|_| random.random_range(0..80)).collect();
        let mut word: u32 = random.random_range(0..5000);
        for (keypoints, words, rows) in &mut views {
            keypoints.push(Keypoint { x_px, y_px, size_px: 6.0, angle_rad: 1.0, response: 1.0 });
            words.push(WordId::new(word));
            rows.extend(row.iter().map(|&value| value + random.random_range(0..20u8)));
            if shared {
                x_px += 12.0 + random.random_range(-3.0..3.0);
            } else {
                [x_px, y_px] = [random.random_range(0.0..640.0), random.random_range(0.0..480.0)];
                row = (0..128).map(|_| random.random_range(0..80)).collect();
                word = random.random_range(0..5000);
            }
        }
    }
    views.map(|(keypoints, words, rows)| {
        let descriptors = Descriptors::new(DescriptorKind::Float, 128, rows).ok();
        match FeatureRecord::new((640, 480), keypoints, words, descriptors) {
            Ok(record) => record,
            Err(error) => unreachable!("{error}"),
        }
    })
}

fn verification(criterion: &mut Criterion) {
    let [earlier, current] = views();
    let camera = RobotCamera::ahead(Pinhole::ideal([500.0; 2], [319.5, 239.5]));
    for (name, method, camera) in [
        ("similarity", VerificationMethod::Similarity, None),
        ("fundamental", VerificationMethod::Epipolar, None),
        ("essential", VerificationMethod::Epipolar, Some(camera)),
    ] {
        let settings = VerificationSettings { method, ..VerificationSettings::default() };
        let verifier = Verifier::new(settings, 0);
        let (from, to) = (View { features: &earlier, camera }, View { features: &current, camera });
        criterion.bench_function(&format!("{name}, 500 keypoints"), |bencher| {
            bencher.iter(|| verifier.compare(black_box(from), black_box(to)));
        });
    }
}

criterion_group!(benches, verification);
criterion_main!(benches);
