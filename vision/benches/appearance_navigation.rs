//! One step of a navigation by looks at 500 features, from the features on: the subgoal, as many
//! neighbours as are tried at most, none of which is seen well enough, and the image before.
//!
//! `cargo bench -p waypost-vision --bench appearance_navigation`

use std::f64::consts::TAU;
use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_navigation::appearance::epipolar::SearchSettings;
use waypost_navigation::appearance::graph::{AppearanceGraph, ImageId, Overlap, Panorama};
use waypost_navigation::appearance::navigator::{AppearanceNavigator, Body, NavigationSettings, Sight};
use waypost_vision::features::Keypoint;
use waypost_vision::panorama::{PanoramicCamera, PanoramicView, Projection};

const FEATURES: usize = 500;
const SIZE_PX: (u32, u32) = (1024, 256);

/// A room of things around, seen from `at`, of which a share is seen again; the rest is new each
/// time.
fn view(at: [f64; 2], shared: usize, seed: u64) -> PanoramicView {
    let mut room = ChaCha8Rng::seed_from_u64(1);
    let mut own = ChaCha8Rng::seed_from_u64(seed);
    let Ok(camera) = PanoramicCamera::new(Projection::Cylindrical, SIZE_PX) else { unreachable!() };
    let (mut keypoints, mut rows) = (Vec::new(), Vec::new());
    for feature in 0..FEATURES {
        let random = if feature < shared { &mut room } else { &mut own };
        let (angle, distance) = (random.random_range(0.0..TAU), random.random_range(2.0..4.0));
        let height = random.random_range(-1.0..1.2);
        let row: Vec<u8> = (0..128).map(|_| random.random_range(0..80)).collect();
        let [x, y] = [distance * f64::cos(angle) - at[0], distance * f64::sin(angle) - at[1]];
        let ray = nalgebra::Vector3::new(x, y, height).normalize();
        let Some([column, row_px]) = camera.project(&ray) else { continue };
        let [x_px, y_px] = [column, row_px].map(|value| value as f32);
        keypoints.push(Keypoint { x_px, y_px, size_px: 6.0, angle_rad: 0.0, response: 1.0 });
        rows.extend(row.into_iter().map(|value| value + own.random_range(0..15u8)));
    }
    let Ok(descriptors) = Descriptors::new(DescriptorKind::Float, 128, rows) else { unreachable!() };
    PanoramicView::of(&keypoints, descriptors, &camera)
}

struct Step {
    views: Vec<PanoramicView>,
    now: PanoramicView,
    before: PanoramicView,
}

impl Panorama for Step {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        self.now.compare(&self.views[image as usize], &SearchSettings::default()).overlap
    }
}

impl Sight for Step {
    fn turned_rad(&self) -> Option<f64> {
        let overlap = self.now.compare(&self.before, &SearchSettings::default()).overlap?;
        Some(-overlap.motion.rotation_rad())
    }

    fn relocalization_candidates(&self) -> Vec<ImageId> {
        vec![0]
    }
}

fn navigation(criterion: &mut Criterion) {
    let settings = NavigationSettings::default();
    let neighbours = settings.max_neighbours as u32 + 4;
    let mut graph = AppearanceGraph::default();
    // The subgoal, its neighbours, and beyond all of them the goal.
    (0..neighbours + 2).for_each(|_| {
        graph.add_image();
    });
    for neighbour in 1..=neighbours {
        graph.link(0, neighbour, 0.9);
        graph.link(neighbour, neighbours + 1, 0.9);
    }
    let shared = |image: u32| if image == 0 { 150 } else { 60 };
    let at = |image: u32| [0.1 * f64::from(image), 0.3];
    let views = (0..neighbours + 2).map(|image| view(at(image), shared(image), 10 + u64::from(image)));
    let step =
        Step { views: views.collect(), now: view([0.0; 2], 150, 2), before: view([0.02, 0.0], 300, 3) };
    let Ok(mut navigator) = AppearanceNavigator::new(&graph, neighbours + 1, settings) else {
        unreachable!()
    };
    criterion.bench_function("one step at 500 features", |bencher| {
        bencher.iter(|| {
            let guidance = navigator.observe(black_box(&graph), black_box(&step), Body::Free);
            assert_eq!(guidance.compared, settings.max_neighbours + 1);
        });
    });
}

criterion_group!(benches, navigation);
criterion_main!(benches);
