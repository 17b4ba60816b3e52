//! A robot that one does not own yet.

use std::fmt::Display;
use std::sync::Arc;

use waypost_client::v1;
use waypost_sim::camera::Camera;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Mount, Sensor, Shot};
use waypost_sim::robot::{Body, OdometryReading, WheelErrors};
use waypost_sim::route::Route;
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{Simulation, SimulationSettings};
use waypost_sim::worlds::NamedWorld;

use crate::failure::Failure;

const FIELD_OF_VIEW_RAD: f64 = 65.0 / 180.0 * std::f64::consts::PI;
const IMAGE_SIZE_PX: (u32, u32) = (320, 240);

/// A building, a way through it, and what a robot sees of it.
pub(crate) struct Building {
    pub(crate) scene: Arc<Scene>,
    pub(crate) rig: CameraRig,
    pub(crate) route: Route,
    pub(crate) route_name: &'static str,
    seed: u64,
}

impl Building {
    /// The world of that name with a way of that name, or its first.
    pub(crate) fn new(world: &str, route: Option<&str>, seed: u64) -> Result<Self, Failure> {
        let names = |names: Vec<&str>| names.join(", ");
        let world = NamedWorld::from_name(world).ok_or_else(|| {
            let worlds = names(NamedWorld::ALL.map(NamedWorld::name).to_vec());
            Failure::Unfit(format!("there is no world {world}; there are {worlds}"))
        })?;
        let routes = world.routes();
        let wanted = match route {
            Some(name) => routes.iter().find(|route| route.name == name),
            None => routes.first(),
        };
        let named = wanted.ok_or_else(|| {
            let routes = names(routes.iter().map(|route| route.name).collect());
            Failure::Unfit(format!("{} has no such route; there are {routes}", world.name()))
        })?;
        let scene = Arc::new(Scene::new(world.plan(seed)));
        let camera = Camera::of_field_of_view(FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX).map_err(unfit)?;
        let rig = CameraRig::new(camera, Mount::default(), Sensor::default()).map_err(unfit)?;
        let route = Route::named(scene.plan(), named, Body::default().radius_m).map_err(unfit)?;
        Ok(Self { scene, rig, route, route_name: named.name, seed })
    }

    /// A robot with wheels of its own at the way's start.
    pub(crate) fn robot(&self) -> Result<Simulation, Failure> {
        let wheels = WheelErrors::drawn(self.seed);
        let settings =
            SimulationSettings { wheels, seed: self.seed, ..SimulationSettings::new(self.rig.clone()) };
        Simulation::new(self.scene.clone(), self.route.start(), settings).map_err(unfit)
    }

    /// What the camera takes, as JPEG.
    pub(crate) fn image(&self, shot: &Shot) -> Result<Vec<u8>, Failure> {
        self.scene.render(&self.rig, shot).to_jpeg().map_err(unfit)
    }

    /// What the robot's sessions declare of its camera.
    pub(crate) fn camera(&self) -> v1::Camera {
        let Mount { forward_m, height_m, yaw_rad } = *self.rig.mount();
        v1::Camera {
            model: Some(v1::camera::Model::FieldOfView(v1::FieldOfView {
                horizontal_rad: FIELD_OF_VIEW_RAD,
            })),
            image_width_px: IMAGE_SIZE_PX.0,
            image_height_px: IMAGE_SIZE_PX.1,
            base_to_camera: Some(pose_message([forward_m, 0.0, height_m], turned(yaw_rad))),
        }
    }
}

/// What the wheels say, as a frame carries it.
pub(crate) fn odometry(reading: &OdometryReading) -> v1::Odometry {
    let (position_m, orientation) = reading.position_and_orientation();
    v1::Odometry {
        pose: Some(pose_message(position_m, orientation)),
        covariance: reading.covariance_6x6().to_vec(),
    }
}

/// A pose on the ground, of a message that has one.
pub(crate) fn planar(message: &v1::Pose) -> Option<Pose> {
    let v1::Pose { position_m, orientation } = message;
    let (v1::Vector3 { x, y, .. }, v1::Quaternion { z, w, .. }) =
        (position_m.as_ref()?, orientation.as_ref()?);
    Some(Pose::new(*x, *y, 2.0 * z.atan2(*w)))
}

/// For `map_err` of what the simulation refuses.
pub(crate) fn unfit(error: impl Display) -> Failure {
    Failure::Unfit(error.to_string())
}

fn turned(yaw_rad: f64) -> [f64; 4] {
    let (sin, cos) = (yaw_rad / 2.0).sin_cos();
    [0.0, 0.0, sin, cos]
}

fn pose_message([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> v1::Pose {
    v1::Pose {
        position_m: Some(v1::Vector3 { x, y, z }),
        orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
    }
}
