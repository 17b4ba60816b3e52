//! A robot drives through a world and takes images.

use std::sync::Arc;

use rayon::prelude::*;
use topomap::odometry::{Odometry, OdometryError};
use topomap::relaxation::PlanarPose;
use waypost_sim::camera::Camera;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Mount, Sensor, Shot};
use waypost_sim::robot::{Body, OdometryReading, WheelErrors};
use waypost_sim::route::Route;
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{Recording, Simulation, SimulationSettings};
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::image::GreyImage;

use super::MapError;

/// Columns and rows of the camera's images.
pub const IMAGE_SIZE_PX: (u32, u32) = (320, 240);

/// What the camera sees from the left to the right edge, in radians.
pub const FIELD_OF_VIEW_RAD: f64 = 65.0 / 180.0 * std::f64::consts::PI;

/// Metres a second on straight ways.
pub const SPEED_M_S: f64 = 0.4;

/// A drive along a route, as it was and as the robot saw it.
#[derive(Debug)]
pub struct Drive {
    /// The world.
    pub scene: Arc<Scene>,
    /// Every step.
    pub recording: Recording,
    /// Where the robot took its images, and what its wheels said.
    pub frames: Vec<DrivenFrame>,
}

/// An image, and what was true and thought to be true when it was taken.
#[derive(Clone, Debug)]
pub struct DrivenFrame {
    /// Nanoseconds since the start.
    pub stamp_ns: i64,
    /// Where the robot was.
    pub truth: PlanarPose,
    /// Where its wheels said it was, from where it started.
    pub odometry: OdometryReading,
    /// What it saw.
    pub image: GreyImage,
}

impl DrivenFrame {
    /// The odometry as a robot sends it.
    ///
    /// # Errors
    /// [`OdometryError`] if it is none.
    pub fn sent_odometry(&self) -> Result<Odometry, OdometryError> {
        let (position_m, orientation) = self.odometry.position_and_orientation();
        Odometry::new(position_m, orientation, Some(&self.odometry.covariance_6x6()))
    }
}

/// Drives a route of a world; `seed` is that of the world, of the wheels' noise and of the camera's.
///
/// # Errors
/// [`MapError`] if the robot does not come to the end of the route.
pub fn drive(
    world: NamedWorld,
    route: &NamedRoute,
    seed: u64,
    wheels: WheelErrors,
) -> Result<Drive, MapError> {
    drive_in(&Arc::new(Scene::new(world.plan(seed))), route, seed, wheels)
}

/// Drives a route of a building; `seed` is that of the wheels' noise and of the camera's.
///
/// # Errors
/// [`MapError`] if the robot does not come to the end of the route.
pub fn drive_in(
    scene: &Arc<Scene>,
    route: &NamedRoute,
    seed: u64,
    wheels: WheelErrors,
) -> Result<Drive, MapError> {
    let route = Route::named(scene.plan(), route, Body::default().radius_m)?;
    let settings = SimulationSettings { wheels, seed, ..SimulationSettings::new(camera_rig()?) };
    drive_along(scene.clone(), &route, settings)
}

/// The camera that all drives see with.
///
/// # Errors
/// [`MapError`] if there is none such.
pub fn camera_rig() -> Result<CameraRig, MapError> {
    let camera = Camera::of_field_of_view(FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX)?;
    Ok(CameraRig::new(camera, Mount::default(), Sensor::default())?)
}

/// Drives a route.
///
/// # Errors
/// [`MapError`] if the robot does not come to its end.
pub fn drive_along(
    scene: Arc<Scene>,
    route: &Route,
    settings: SimulationSettings,
) -> Result<Drive, MapError> {
    let rig = settings.rig.clone();
    let recording = Simulation::new(scene.clone(), route.start(), settings)?.drive_along(route, SPEED_M_S)?;
    let taken: Vec<_> = recording.frames().collect();
    let frames = taken.into_par_iter().map(|frame| {
        Ok(DrivenFrame {
            stamp_ns: frame.stamp_ns,
            truth: planar(&frame.shot.pose),
            odometry: frame.odometry,
            image: image_of(&scene, &rig, &frame.shot)?,
        })
    });
    let frames = frames.collect::<Result<_, MapError>>()?;
    Ok(Drive { scene, recording, frames })
}

/// What the camera sees.
///
/// # Errors
/// [`MapError`] if that is no image.
pub fn image_of(scene: &Scene, rig: &CameraRig, shot: &Shot) -> Result<GreyImage, MapError> {
    let image = scene.render(rig, shot);
    Ok(GreyImage::new(image.width_px(), image.height_px(), image.pixels().to_vec())?)
}

/// The same pose, as maps have them.
#[must_use]
pub fn planar(pose: &Pose) -> PlanarPose {
    PlanarPose::new(pose.x_m, pose.y_m, pose.heading_rad)
}
