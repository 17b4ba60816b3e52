//! A robot drives through a world and takes images.

use std::sync::Arc;

use anyhow::Result;
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use posegraph::PlanarPose;
use rayon::prelude::*;
use topomap::metric::Odometry;
use waypost_sim::drive::{Building, SPEED_M_S, WHEN_MOVED};
use waypost_sim::image::GreyImage as Rendered;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Mount};
use waypost_sim::robot::{OdometryReading, WheelErrors};
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{CameraTrigger, Recording};
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::image::GreyImage;
use waypost_vision::structure::RobotCamera;
use waypost_vision::verification::Pinhole;

/// A drive along a route, as it was and as the robot saw it.
#[derive(Debug)]
pub(crate) struct Drive {
    /// The world.
    pub scene: Arc<Scene>,
    /// Every step.
    pub recording: Recording,
    /// Where the robot took its images, and what its wheels said.
    pub frames: Vec<DrivenFrame>,
}

/// An image, and what was true and thought to be true when it was taken.
#[derive(Clone, Debug)]
pub(crate) struct DrivenFrame {
    /// Nanoseconds since the start.
    pub stamp_ns: i64,
    /// Where the robot was.
    pub truth: PlanarPose,
    /// Where its wheels said it was, from where it started.
    pub odometry: OdometryReading,
    /// What it saw.
    pub image: GreyImage,
    /// By which camera.
    pub camera: RobotCamera,
}

/// The odometry as a robot sends it.
pub(crate) fn sent_odometry(reading: &OdometryReading) -> Result<Odometry> {
    let (position_m, orientation) = reading.position_and_orientation();
    Ok(Odometry::new(position_m, orientation, Some(&reading.covariance_6x6()))?)
}

/// Drives a route of a world; `seed` is that of the world, of the wheels' noise and of the camera's.
pub(crate) fn drive(world: NamedWorld, route: &NamedRoute, seed: u64, wheels: WheelErrors) -> Result<Drive> {
    drive_through(&Building::named(world, seed, route)?, seed, wheels, WHEN_MOVED)
}

/// Drives through a building, with images when the trigger says; `seed` is that of the wheels'
/// noise and of the camera's.
pub(crate) fn drive_through(
    building: &Building,
    seed: u64,
    wheels: WheelErrors,
    trigger: CameraTrigger,
) -> Result<Drive> {
    let recording = building.robot(wheels, seed, trigger)?.drive_along(&building.route, SPEED_M_S)?;
    let camera = robot_camera(&building.rig);
    let taken: Vec<_> = recording.frames().collect();
    let frames = taken.into_par_iter().map(|frame| {
        Ok(DrivenFrame {
            stamp_ns: frame.stamp_ns,
            truth: planar(&frame.shot.pose),
            odometry: frame.odometry,
            image: grey(&building.image(&frame.shot))?,
            camera,
        })
    });
    let frames = frames.collect::<Result<_>>()?;
    Ok(Drive { scene: building.scene.clone(), recording, frames })
}

/// A rendered image, as features are extracted from.
pub(crate) fn grey(rendered: &Rendered) -> Result<GreyImage> {
    Ok(GreyImage::new(rendered.width_px(), rendered.height_px(), rendered.pixels().to_vec())?)
}

/// A simulated camera, as a robot declares it.
pub(crate) fn robot_camera(rig: &CameraRig) -> RobotCamera {
    let [focal_px, center_px] = rig
        .camera()
        .intrinsics_px()
        .unwrap_or_else(|| unreachable!("robots that drive by wheels look ahead"));
    let &Mount { forward_m, height_m, yaw_rad } = rig.mount();
    let position = Translation3::new(forward_m, 0.0, height_m);
    let base_to_camera =
        Isometry3::from_parts(position, UnitQuaternion::from_euler_angles(0.0, 0.0, yaw_rad));
    RobotCamera { pinhole: Pinhole::ideal(focal_px, center_px), base_to_camera }
}

/// The same pose, as maps have them.
pub(crate) fn planar(pose: &Pose) -> PlanarPose {
    PlanarPose::new(pose.x_m, pose.y_m, pose.heading_rad)
}
