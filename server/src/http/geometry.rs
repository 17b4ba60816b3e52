//! Poses and cameras. By REP-103: right-handed, x forward, y left, z up; metres and radians.

use nalgebra::Isometry3;
use prost::Message;
use serde::Serialize;
use topomap::odometry;
use utoipa::ToSchema;
use waypost_proto::v1;

use crate::error::ServiceError;

/// Where the wheels say the robot is.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Odometry {
    /// Of `base_link` in the session's odom frame, which drifts but never jumps.
    pose: Pose,
    /// 6 x 6, row by row, of (x, y, z, rotation about x, y, z), in m² and rad². Empty if unknown.
    #[schema(max_items = 36)]
    covariance: Vec<f64>,
}

/// A frame of coordinates in another one, its parent.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Pose {
    position_m: Vector3,
    orientation: Quaternion,
}

#[derive(Debug, Serialize, ToSchema)]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

/// A rotation. (0, 0, 0, 1) is none.
#[derive(Debug, Serialize, ToSchema)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl From<odometry::Odometry> for Odometry {
    fn from(odometry: odometry::Odometry) -> Self {
        Self {
            pose: (*odometry.pose()).into(),
            // Stored column by column.
            covariance: odometry
                .covariance()
                .map_or_else(Vec::new, |covariance| covariance.transpose().as_slice().to_vec()),
        }
    }
}

impl From<Isometry3<f64>> for Pose {
    fn from(pose: Isometry3<f64>) -> Self {
        let (position, orientation) = (pose.translation, pose.rotation);
        Self {
            position_m: Vector3 { x: position.x, y: position.y, z: position.z },
            orientation: Quaternion {
                x: orientation.i,
                y: orientation.j,
                z: orientation.k,
                w: orientation.w,
            },
        }
    }
}

/// How the robot sees, as it was declared. At most one of the models is there.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Camera {
    #[schema(required)]
    pinhole: Option<CalibratedLens>,
    #[schema(required)]
    field_of_view: Option<FieldOfView>,
    /// Equidistant (Kannala-Brandt).
    #[schema(required)]
    fisheye: Option<CalibratedLens>,
    #[schema(required)]
    panorama: Option<Panorama>,
    #[schema(required)]
    hyperbolic_mirror: Option<HyperbolicMirror>,
    /// Size of the images that the model is for; 0 if not declared.
    image_width_px: u32,
    image_height_px: u32,
    /// Pose of the camera in `base_link`.
    #[schema(required)]
    base_to_camera: Option<Pose>,
}

/// A lens with calibrated intrinsics, in pixels.
#[derive(Debug, Serialize, ToSchema)]
struct CalibratedLens {
    fx_px: f64,
    fy_px: f64,
    cx_px: f64,
    cy_px: f64,
    /// Of a pinhole (k1, k2, p1, p2, k3): none, 4 or 5 values. Of a fisheye (k1, k2, k3, k4): none or 4.
    distortion: Vec<f64>,
}

/// Perspective of which only the opening angle is known.
#[derive(Debug, Serialize, ToSchema)]
struct FieldOfView {
    horizontal_rad: f64,
}

/// An image that goes all the way round.
#[derive(Debug, Serialize, ToSchema)]
struct Panorama {
    #[schema(required)]
    projection: Option<Projection>,
    /// From the bottom to the top edge.
    vertical_rad: f64,
}

#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Projection {
    Cylindrical,
    Equirectangular,
}

/// A camera that looks up into a hyperbolic mirror, in pixels of its round image.
#[derive(Debug, Serialize, ToSchema)]
struct HyperbolicMirror {
    center_x_px: f64,
    center_y_px: f64,
    inner_radius_px: f64,
    outer_radius_px: f64,
    /// Eccentricity of the hyperbola.
    eccentricity: f64,
    /// How far from the centre the horizon is seen; 0 if it is not known.
    horizon_radius_px: f64,
    /// Where ahead lies in the image, from its right counter-clockwise.
    ahead_rad: f64,
}

impl Camera {
    /// A camera as sessions keep it.
    pub(super) fn decode(encoded: &[u8]) -> Result<Self, ServiceError> {
        use v1::camera::Model;
        let camera = v1::Camera::decode(encoded).map_err(ServiceError::internal)?;
        let v1::Camera { model, image_width_px, image_height_px, base_to_camera } = camera;
        let mut decoded = Self {
            pinhole: None,
            field_of_view: None,
            fisheye: None,
            panorama: None,
            hyperbolic_mirror: None,
            image_width_px,
            image_height_px,
            base_to_camera: base_to_camera.map(Pose::from),
        };
        match model {
            None => {}
            Some(Model::Pinhole(v1::Pinhole { fx_px, fy_px, cx_px, cy_px, distortion })) => {
                decoded.pinhole = Some(CalibratedLens { fx_px, fy_px, cx_px, cy_px, distortion });
            }
            Some(Model::FieldOfView(v1::FieldOfView { horizontal_rad })) => {
                decoded.field_of_view = Some(FieldOfView { horizontal_rad });
            }
            Some(Model::Fisheye(v1::Fisheye { fx_px, fy_px, cx_px, cy_px, distortion })) => {
                decoded.fisheye = Some(CalibratedLens { fx_px, fy_px, cx_px, cy_px, distortion });
            }
            Some(Model::Panorama(panorama)) => decoded.panorama = Some(panorama.into()),
            Some(Model::HyperbolicMirror(mirror)) => decoded.hyperbolic_mirror = Some(mirror.into()),
        }
        Ok(decoded)
    }
}

impl From<v1::Panorama> for Panorama {
    fn from(panorama: v1::Panorama) -> Self {
        use v1::panorama::Projection as Declared;
        let projection = match panorama.projection() {
            Declared::Cylindrical => Some(Projection::Cylindrical),
            Declared::Equirectangular => Some(Projection::Equirectangular),
            Declared::Unspecified => None,
        };
        let v1::Panorama { projection: _, vertical_rad } = panorama;
        Self { projection, vertical_rad }
    }
}

impl From<v1::HyperbolicMirror> for HyperbolicMirror {
    fn from(mirror: v1::HyperbolicMirror) -> Self {
        let v1::HyperbolicMirror {
            center_x_px,
            center_y_px,
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            horizon_radius_px,
            ahead_rad,
        } = mirror;
        Self {
            center_x_px,
            center_y_px,
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            horizon_radius_px,
            ahead_rad,
        }
    }
}

impl From<v1::Pose> for Pose {
    fn from(pose: v1::Pose) -> Self {
        let v1::Pose { position_m, orientation } = pose;
        // Cameras are checked when a session is opened: both are there.
        let v1::Vector3 { x, y, z } = position_m.unwrap_or_default();
        let position_m = Vector3 { x, y, z };
        let v1::Quaternion { x, y, z, w } = orientation.unwrap_or_default();
        Self { position_m, orientation: Quaternion { x, y, z, w } }
    }
}
