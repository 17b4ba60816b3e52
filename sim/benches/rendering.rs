//! Time of an image, on one thread.
#![expect(clippy::expect_used, reason = "a benchmark's own inputs are valid")]

use criterion::{Criterion, criterion_group, criterion_main};
use waypost_sim::camera::Camera;
use waypost_sim::light::Light;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Mount, Sensor, Shot};
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;

fn rendering(criterion: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
    let mut group = criterion.benchmark_group("rendering");
    group.sample_size(20);
    group.bench_function("paint_office", |bencher| bencher.iter(|| Scene::new(NamedWorld::Office.plan(1))));
    let scene = Scene::new(NamedWorld::Office.plan(1));
    let cameras = [
        ("perspective_320x240", Camera::of_field_of_view(65_f64.to_radians(), (320, 240))),
        ("cylindrical_1024x256", Camera::cylindrical((1024, 256))),
    ];
    for (name, camera) in cameras {
        let rig =
            CameraRig::new(camera.expect("a camera"), Mount::default(), Sensor::default()).expect("a rig");
        let shot = |heading_rad| Shot {
            pose: Pose::new(6.0, 5.0, heading_rad),
            speed: [0.4, 0.0],
            people: Vec::new(),
            light: Light::default(),
            seed: 1,
        };
        let mut heading = 0.0;
        let render = || {
            heading += 0.7;
            pool.install(|| scene.render(&rig, &shot(heading)))
        };
        let mut render = render;
        group.bench_function(name, |bencher| bencher.iter(&mut render));
    }
    group.finish();
}

criterion_group!(benches, rendering);
criterion_main!(benches);
