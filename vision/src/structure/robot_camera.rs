//! A camera, and where it sits on its robot.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};

use crate::camera::Pinhole;
use crate::feature_record::FeatureRecord;
use crate::features::Keypoint;

/// How a robot's camera projects, and where it is. Its axes are those of the robot (REP-103): x
/// where it looks, y to the left, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotCamera {
    /// Intrinsics, in pixels of the image that keypoints are in.
    pub pinhole: Pinhole,
    /// Pose of the camera in `base_link`, in metres.
    pub base_to_camera: Isometry3<f64>,
}

/// Standard deviation of where a keypoint lies, in pixels of an image of [`SIGMA_AT_WIDTH_PX`].
const SIGMA_PX: f64 = 1.0;
const SIGMA_AT_WIDTH_PX: f64 = 320.0;

/// Keypoints of larger features lie less well, up to so many times.
const MAX_SIGMA_FACTOR: f64 = 4.0;

/// Nearer to the camera's plane than this nothing is seen, in metres.
const NEAREST_M: f64 = 0.05;

/// Where a keypoint is seen, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sighted {
    /// To the left and up, at depth 1.
    pub(super) at: Vector2<f64>,
    /// Of both, at depth 1.
    pub(super) sigma: f64,
}

impl Sighted {
    /// The ray, of depth 1.
    pub(super) fn ray(&self) -> Vector3<f64> {
        Vector3::new(1.0, self.at.x, self.at.y)
    }
}

impl RobotCamera {
    /// A camera at `base_link`'s origin that looks where the robot drives.
    #[must_use]
    pub fn ahead(pinhole: Pinhole) -> Self {
        Self { pinhole, base_to_camera: Isometry3::identity() }
    }

    /// Where each keypoint is seen; `None` where no ray ends at its pixel.
    pub(super) fn sighted(&self, features: &FeatureRecord) -> Vec<Option<Sighted>> {
        let sizes = features.keypoints().iter().map(|keypoint| keypoint.size_px);
        let least_size_px = f64::from(sizes.fold(f32::INFINITY, f32::min));
        let width_px = f64::from(features.image_size_px().0);
        let sigma = SIGMA_PX * width_px / SIGMA_AT_WIDTH_PX / self.pinhole.focal_px[0];
        let sighted = |keypoint: &Keypoint| {
            let ray = self.pinhole.ray(keypoint);
            let larger = f64::from(keypoint.size_px) / least_size_px;
            let factor = if larger.is_finite() { larger.clamp(1.0, MAX_SIGMA_FACTOR) } else { 1.0 };
            // A pixel's x is to the right and its y down.
            ray.is_finite().then(|| Sighted { at: Vector2::new(-ray.re, -ray.im), sigma: sigma * factor })
        };
        features.keypoints().iter().map(sighted).collect()
    }

    pub(super) fn rotation(&self) -> UnitQuaternion<f64> {
        self.base_to_camera.rotation
    }

    /// The camera's centre in `base_link`.
    pub(super) fn center_m(&self) -> Vector3<f64> {
        self.base_to_camera.translation.vector
    }

    /// Where a point of `base_link` is seen, at depth 1; `None` behind the camera.
    pub(super) fn project(&self, point_m: &Vector3<f64>) -> Option<Vector2<f64>> {
        let Point3 { coords } = self.base_to_camera.inverse_transform_point(&Point3::from(*point_m));
        (coords.x > NEAREST_M).then(|| Vector2::new(coords.y, coords.z) / coords.x)
    }
}
