//! The cameras of the robots that drive through the worlds.

use std::f64::consts::PI;

use crate::camera::{Camera, Panorama};
use crate::render::{CameraRig, Mount, Sensor};

/// What the camera sees from the left to the right edge, in radians.
pub const FIELD_OF_VIEW_RAD: f64 = 65.0 / 180.0 * PI;

/// Columns and rows of the camera's images.
pub const IMAGE_SIZE_PX: (u32, u32) = (320, 240);

/// Columns and rows of panoramas: 38 degrees up and down on a cylinder, 45 by elevation.
pub const PANORAMA_SIZE_PX: (u32, u32) = (512, 128);

/// The camera of the robot.
#[must_use]
pub fn camera_rig() -> CameraRig {
    rig(FIELD_OF_VIEW_RAD, Mount::default())
}

/// The camera of the robots in the gallery: it sees 85 degrees, from 0.6 m above the floor.
pub(crate) fn gallery_camera_rig() -> CameraRig {
    rig(85.0 / 180.0 * PI, Mount { height_m: 0.6, ..Mount::default() })
}

/// A camera that looks all around.
#[must_use]
pub fn panorama_rig(panorama: Panorama) -> CameraRig {
    let camera = match panorama {
        Panorama::Cylindrical => Camera::cylindrical(PANORAMA_SIZE_PX),
        Panorama::Equirectangular => Camera::equirectangular(PANORAMA_SIZE_PX),
    };
    let camera = camera.unwrap_or_else(|error| unreachable!("such a camera can be: {error}"));
    on_a_robot(camera, Mount::default())
}

fn rig(field_of_view_rad: f64, mount: Mount) -> CameraRig {
    let camera = Camera::of_field_of_view(field_of_view_rad, IMAGE_SIZE_PX)
        .unwrap_or_else(|error| unreachable!("such a camera can be: {error}"));
    on_a_robot(camera, mount)
}

fn on_a_robot(camera: Camera, mount: Mount) -> CameraRig {
    CameraRig::new(camera, mount, Sensor::default())
        .unwrap_or_else(|error| unreachable!("the defaults are in range: {error}"))
}
