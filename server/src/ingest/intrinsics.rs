//! How a perspective camera turns pixels into rays.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use waypost_vision::structure::RobotCamera;
use waypost_vision::verification::{Distortion, Pinhole};

use crate::camera::{Camera, CameraModel};
use crate::error::ServiceError;

/// What geometry can use of a camera: how a perspective one turns pixels into rays, and where it sits. Cameras of other kinds have no
/// essential matrix in pixels, and are treated as unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Intrinsics {
    lens: Lens,
    /// Size of the images that they are for; those that are sent, if it was not declared.
    image_size_px: Option<(u32, u32)>,
    /// Where it sits on the robot: at its middle and looking ahead, if that was not declared.
    base_to_camera: Isometry3<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Lens {
    Calibrated(Pinhole),
    FieldOfView { horizontal_rad: f64 },
}

/// Images whose sides are in another proportion, by more than rounding, are not the declared ones made smaller.
pub(super) const MAX_STRETCH: f64 = 0.02;

impl Intrinsics {
    /// None if it is no perspective camera.
    pub(crate) fn of_camera(camera: &Camera) -> Option<Self> {
        let lens = match camera.model.as_ref()? {
            CameraModel::Pinhole { focal_px, center_px, distortion } => {
                let coefficient = |index: usize| distortion.get(index).copied().unwrap_or(0.0);
                let radial = [coefficient(0), coefficient(1), coefficient(4)];
                let distortion = Distortion { radial, tangential: [coefficient(2), coefficient(3)] };
                Lens::Calibrated(Pinhole { focal_px: *focal_px, center_px: *center_px, distortion })
            }
            CameraModel::FieldOfView { horizontal_rad } => {
                Lens::FieldOfView { horizontal_rad: *horizontal_rad }
            }
            CameraModel::Fisheye { .. }
            | CameraModel::Cylindrical { .. }
            | CameraModel::Equirectangular { .. }
            | CameraModel::HyperbolicMirror(_) => return None,
        };
        let base_to_camera =
            camera.base_to_camera.map_or_else(Isometry3::identity, |([x, y, z], orientation)| {
                let [i, j, k, w] = orientation;
                let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
                Isometry3::from_parts(Translation3::new(x, y, z), rotation)
            });
        Some(Self { lens, image_size_px: camera.image_size_px, base_to_camera })
    }

    /// The camera as it took an image of that width and height, in pixels of it. None if that is no image of the
    /// declared size made smaller or larger.
    pub(crate) fn of_image(&self, size_px: (u32, u32)) -> Option<RobotCamera> {
        let declared_px = self.image_size_px.unwrap_or(size_px);
        let factor = |to: u32, from: u32| f64::from(to) / f64::from(from);
        let stretch = factor(size_px.0, declared_px.0) / factor(size_px.1, declared_px.1);
        if (stretch - 1.0).abs() > MAX_STRETCH {
            return None;
        }
        let pinhole = match self.lens {
            Lens::Calibrated(pinhole) => pinhole.resized(declared_px, size_px),
            Lens::FieldOfView { horizontal_rad } => Pinhole::of_field_of_view(horizontal_rad, size_px),
        };
        Some(RobotCamera { pinhole, base_to_camera: self.base_to_camera })
    }

    /// # Errors
    /// InvalidArgument for an image that the declared camera does not take.
    pub(crate) fn check(&self, (width, height): (u32, u32)) -> Result<(), ServiceError> {
        match (self.of_image((width, height)), self.image_size_px) {
            (None, Some((declared_width, declared_height))) => Err(ServiceError::invalid(format_args!(
                "the image has {width} x {height} pixels, another shape than the {declared_width} x {declared_height} \
                 that the session's camera was declared with; send its images whole, or open a session with the camera \
                 that takes these"
            ))),
            (Some(_), None) => self.check_centre((width, height)),
            (Some(_), Some(_)) | (None, None) => Ok(()),
        }
    }

    /// A camera whose images' size was not declared is of those that it sends, unless it looks past them.
    fn check_centre(&self, (width, height): (u32, u32)) -> Result<(), ServiceError> {
        match self.lens {
            Lens::Calibrated(Pinhole { center_px: [x, y], .. })
                if !(0.0..=f64::from(width)).contains(&x) || !(0.0..=f64::from(height)).contains(&y) =>
            {
                Err(ServiceError::invalid(format_args!(
                    "the centre of the session's camera, ({x}, {y}) pixels, lies outside of its images of {width} x {height}; \
                     declare it with image_width_px and image_height_px of the images that it was calibrated with"
                )))
            }
            Lens::Calibrated(_) | Lens::FieldOfView { .. } => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics(model: CameraModel, image_size_px: Option<(u32, u32)>) -> Option<Intrinsics> {
        Intrinsics::of_camera(&Camera { model: Some(model), image_size_px, base_to_camera: None })
    }

    #[test]
    fn intrinsics_follow_the_size_of_the_image() {
        let distortion = vec![0.1, 0.2, 0.3, 0.4, 0.5];
        let pinhole =
            CameraModel::Pinhole { focal_px: [500.0, 490.0], center_px: [319.5, 239.5], distortion };
        let found = intrinsics(pinhole, Some((640, 480))).unwrap();
        let halved = found.of_image((320, 240)).unwrap().pinhole;
        assert_eq!((halved.focal_px, halved.center_px), ([250.0, 245.0], [159.5, 119.5]));
        assert_eq!(halved.distortion, Distortion { radial: [0.1, 0.2, 0.5], tangential: [0.3, 0.4] });
        // Rounded sides are taken, another shape is not.
        assert!(found.of_image((213, 160)).is_some());
        assert_eq!(found.of_image((640, 360)), None);
        assert!(found.check((213, 160)).is_ok());
        let refused = found.check((640, 360)).unwrap_err().to_string();
        assert!(refused.contains("640 x 360") && refused.contains("640 x 480"), "{refused}");
        let elsewhere = Intrinsics { image_size_px: None, ..found };
        assert!(elsewhere.check((640, 480)).is_ok());
        let refused = elsewhere.check((320, 200)).unwrap_err().to_string();
        assert!(refused.contains("(319.5, 239.5)") && refused.contains("image_width_px"), "{refused}");
        let view = CameraModel::FieldOfView { horizontal_rad: std::f64::consts::FRAC_PI_2 };
        let wide = intrinsics(view, None).unwrap().of_image((200, 100)).unwrap().pinhole;
        assert!((wide.focal_px[0] - 100.0).abs() < 1e-9 && wide.center_px == [99.5, 49.5]);
        let fisheye =
            CameraModel::Fisheye { focal_px: [300.0; 2], center_px: [160.0, 120.0], distortion: vec![] };
        assert_eq!(intrinsics(fisheye, None), None);
    }
}
