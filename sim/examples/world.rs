//! A look at a world: its plan with a route that a robot drove, and what it saw.
//!
//! `cargo run --release -p waypost-sim --example world -- office 1 DIR [ROUTE]`
//!
//! Writes `plan.svg`, with the truth and what the wheels said, some images of the drive as
//! `000.png` and so on, and panoramas as `panorama-000.png`.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector2;
use waypost_sim::camera::Camera;
use waypost_sim::drawing::{Layer, Marks, plan_svg};
use waypost_sim::render::{CameraRig, Mount, Sensor};
use waypost_sim::robot::WheelErrors;
use waypost_sim::route::Route;
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{Recording, Simulation, SimulationSettings};
use waypost_sim::worlds::NamedWorld;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, seed, folder, rest @ ..] = arguments.as_slice() else {
        return Err("give a world, a seed and a folder, and a route if you like".into());
    };
    let names = || NamedWorld::ALL.map(NamedWorld::name).join(", ");
    let world =
        NamedWorld::from_name(name).ok_or_else(|| format!("no world {name}; there are {}", names()))?;
    let routes = world.routes();
    let named = match rest.first() {
        Some(route) => routes.iter().find(|named| named.name == route),
        None => routes.first(),
    };
    let named = named.ok_or_else(|| {
        let names: Vec<&str> = routes.iter().map(|route| route.name).collect();
        format!("no such route; there are {}", names.join(", "))
    })?;
    let seed: u64 = seed.parse()?;
    let scene = Arc::new(Scene::new(world.plan(seed)));
    let camera = Camera::of_field_of_view(65_f64.to_radians(), (320, 240))?;
    let rig = CameraRig::new(camera, Mount::default(), Sensor::default())?;
    let route = Route::named(scene.plan(), named, 0.25)?;
    let settings =
        SimulationSettings { wheels: WheelErrors::drawn(seed), seed, ..SimulationSettings::new(rig.clone()) };
    let recording = Simulation::new(scene.clone(), route.start(), settings)?.drive_along(&route, 0.4)?;
    let folder = Path::new(folder);
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("plan.svg"), plan_svg(scene.plan(), &layers(&route, &recording)))?;
    write_images(folder, &scene, &rig, &recording)?;
    eprintln!(
        "{} {}: {:.1} m, {} images, {} collisions",
        world.name(),
        named.name,
        recording.length_m(),
        recording.frames().count(),
        recording.collisions
    );
    Ok(())
}

/// What the robot drove, and what its wheels said, laid to where it started.
fn layers(route: &Route, recording: &Recording) -> Vec<Layer> {
    let ticks = &recording.ticks;
    let start = route.start();
    let truth = ticks.iter().map(|tick| tick.truth.position()).collect();
    let odometry = ticks.iter().map(|tick| start.compose(&tick.odometry.pose).position()).collect();
    let places: Vec<Vector2<f64>> = recording.frames().map(|frame| frame.shot.pose.position()).collect();
    [
        ("truth", "#1459aa", Marks::Path(truth)),
        ("odometry", "#c83c00", Marks::Path(odometry)),
        ("images", "#208050", Marks::Dots(places)),
    ]
    .map(|(name, colour, marks)| Layer { name: name.to_owned(), colour: colour.to_owned(), marks })
    .to_vec()
}

/// One image of ten, and a panorama of forty.
fn write_images(
    folder: &Path,
    scene: &Scene,
    rig: &CameraRig,
    recording: &Recording,
) -> Result<(), Box<dyn Error>> {
    let around = CameraRig::new(Camera::cylindrical((1024, 256))?, *rig.mount(), Sensor::default())?;
    for frame in recording.frames().filter(|frame| frame.number % 10 == 0) {
        let name = format!("{:03}.png", frame.number);
        std::fs::write(folder.join(&name), scene.render(rig, &frame.shot).to_png()?)?;
        if frame.number % 40 == 0 {
            std::fs::write(
                folder.join(format!("panorama-{name}")),
                scene.render(&around, &frame.shot).to_png()?,
            )?;
        }
    }
    Ok(())
}
