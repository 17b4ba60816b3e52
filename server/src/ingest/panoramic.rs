//! Cameras that see all around: from their images to panoramas, and from features to rays.

use std::f64::consts::TAU;
use std::sync::Arc;

use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Features, Keypoint};
use waypost_vision::image::GreyImage;
use waypost_vision::panorama::mirror::{HyperbolicMirror, MirrorSettings};
use waypost_vision::panorama::{PanoramicCamera, PanoramicView, Projection};

use super::intrinsics::MAX_STRETCH;
use crate::camera::{Camera, CameraModel, Mirror};
use crate::error::ServiceError;

/// What is to be known of a camera to make panoramas of its images.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PanoramicOptics {
    surround: Surround,
    /// What all of this is of.
    camera: Arc<Camera>,
    /// By which the camera is turned to the left on the robot.
    yaw_rad: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Surround {
    Panorama { projection: Projection, vertical_rad: Option<f64> },
    Mirror(HyperbolicMirror),
}

impl PanoramicOptics {
    /// None if it does not see all around, or that is not known well enough.
    pub(crate) fn of_camera(camera: &Camera) -> Option<Self> {
        let [x, y, z, w] = camera.base_to_camera.map_or([0.0; 4], |(_, orientation)| orientation);
        let yaw_rad = (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z);
        let surround = match camera.model.as_ref()? {
            CameraModel::Cylindrical { vertical_rad } => Surround::Panorama {
                projection: Projection::Cylindrical,
                vertical_rad: Some(*vertical_rad).filter(|angle| *angle > 0.0),
            },
            CameraModel::Equirectangular { vertical_rad } => {
                Surround::Panorama { projection: Projection::Equirectangular, vertical_rad: *vertical_rad }
            }
            CameraModel::HyperbolicMirror(mirror) => Surround::Mirror(hyperbolic(mirror)?),
            CameraModel::Pinhole { .. } | CameraModel::FieldOfView { .. } | CameraModel::Fisheye { .. } => {
                return None;
            }
        };
        Some(Self { surround, camera: Arc::new(camera.clone()), yaw_rad })
    }

    /// The camera that they are of.
    pub(crate) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// A heading of the camera's as one of the robot's.
    pub(crate) fn of_the_robot(&self, heading_rad: f64) -> f64 {
        let turned = heading_rad + self.yaw_rad;
        turned.sin().atan2(turned.cos())
    }

    /// Refuses an image that the declared camera does not take.
    fn check(&self, image: &GreyImage) -> Result<(), ServiceError> {
        let (width, height) = (image.width(), image.height());
        if let Some((declared_width, declared_height)) = self.camera.image_size_px {
            let fits = match self.surround {
                Surround::Panorama { .. } => alike(
                    f64::from(width) / f64::from(height),
                    f64::from(declared_width) / f64::from(declared_height),
                ),
                // The mirror's radii are in pixels of the declared image.
                Surround::Mirror(_) => (width, height) == (declared_width, declared_height),
            };
            if !fits {
                return Err(ServiceError::invalid(format_args!(
                    "the image has {width} x {height} pixels, but the camera was declared with {declared_width} x \
                     {declared_height}; send its images whole, or open the stream anew with the camera's true size"
                )));
            }
        }
        let Surround::Panorama { projection, vertical_rad } = self.surround else { return Ok(()) };
        let half = TAU * f64::from(height) / f64::from(width) / 2.0;
        let shown_rad = match projection {
            Projection::Cylindrical => 2.0 * half.atan(),
            Projection::Equirectangular => 2.0 * half,
        };
        if vertical_rad.is_some_and(|declared| !alike(shown_rad, declared)) {
            return Err(ServiceError::invalid(format_args!(
                "a panorama of {width} x {height} square pixels all around shows {shown_rad:.3} rad from the bottom to \
                 the top edge, but the camera was declared with {:.3} rad; send panoramas of square pixels that go all \
                 the way round, or declare their vertical angle",
                vertical_rad.unwrap_or_default()
            )));
        }
        PanoramicCamera::new(projection, (width, height)).map_err(ServiceError::invalid)?;
        Ok(())
    }

    /// The panorama in an image: the image itself, or what a mirror shows, unwrapped to `width_px` columns at most.
    ///
    /// InvalidArgument if the declared camera takes no such image.
    pub(crate) fn panorama(&self, image: GreyImage, width_px: u32) -> Result<GreyImage, ServiceError> {
        self.check(&image)?;
        match self.surround {
            Surround::Panorama { .. } => Ok(image),
            Surround::Mirror(mirror) => {
                let around_px = (f64::from(image.width().min(image.height())) * TAU / 2.0) as u32;
                let size_px = mirror.panorama_size_px(width_px.min(around_px));
                mirror.unwrapped(&image, size_px).map_err(ServiceError::invalid)
            }
        }
    }

    /// The features of a panorama that are of the world: not those at the edges of what a mirror shows.
    pub(crate) fn of_the_world(&self, features: Features, size_px: (u32, u32)) -> Features {
        let Surround::Mirror(mirror) = self.surround else { return features };
        let is_whole = |keypoint: &Keypoint| {
            mirror.shows_row(size_px, f64::from(keypoint.y_px), f64::from(keypoint.size_px))
        };
        features.filtered(is_whole)
    }

    /// Features of a panorama as rays; None if they came without descriptors, or lie in no panorama.
    pub(crate) fn view(&self, features: &FeatureRecord) -> Option<PanoramicView> {
        let projection = match self.surround {
            Surround::Panorama { projection, .. } => projection,
            Surround::Mirror(_) => Projection::Cylindrical,
        };
        let camera = PanoramicCamera::new(projection, features.image_size_px()).ok()?;
        Some(PanoramicView::of(features.keypoints(), features.descriptors()?.clone(), &camera))
    }
}

/// None if the horizon is not known.
fn hyperbolic(mirror: &Mirror) -> Option<HyperbolicMirror> {
    let Mirror { center_px, inner_radius_px, outer_radius_px, eccentricity, horizon_radius_px, ahead_rad } =
        *mirror;
    let settings = MirrorSettings {
        center_px,
        // The very centre shows the camera itself.
        radii_px: [inner_radius_px.max(1.0), outer_radius_px],
        horizon_radius_px,
        parameter: 2.0 * eccentricity / (1.0 + eccentricity * eccentricity),
        ahead_rad,
    };
    HyperbolicMirror::new(settings).ok()
}

fn alike(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() <= MAX_STRETCH
}

#[cfg(test)]
mod tests {
    use super::*;

    fn optics(model: CameraModel, image_size_px: Option<(u32, u32)>) -> Option<PanoramicOptics> {
        PanoramicOptics::of_camera(&Camera { model: Some(model), image_size_px, base_to_camera: None })
    }

    fn grey(width: u32, height: u32) -> GreyImage {
        GreyImage::new(width, height, vec![128; width as usize * height as usize]).unwrap()
    }

    #[test]
    fn panoramas_have_the_proportions_that_were_declared() {
        // 64 of 256 columns' width: slopes from -π / 4 to π / 4.
        let vertical_rad = 2.0 * (TAU / 8.0).atan();
        let declared = optics(CameraModel::Cylindrical { vertical_rad }, Some((1024, 256))).unwrap();
        for size in [(1024, 256), (512, 128)] {
            assert!(declared.panorama(grey(size.0, size.1), 512).is_ok(), "{size:?}");
        }
        let refused = declared.panorama(grey(640, 480), 512).unwrap_err().to_string();
        assert!(refused.contains("640 x 480") && refused.contains("1024 x 256"), "{refused}");
        let undeclared = optics(CameraModel::Cylindrical { vertical_rad }, None).unwrap();
        assert!(undeclared.panorama(grey(256, 64), 512).is_ok());
        let refused = undeclared.panorama(grey(256, 100), 512).unwrap_err().to_string();
        assert!(refused.contains("vertical angle"), "{refused}");
    }

    #[test]
    fn a_mirror_is_unwrapped_if_its_horizon_is_known() {
        let mirror = |horizon_radius_px| {
            CameraModel::HyperbolicMirror(Mirror {
                center_px: [200.0, 150.0],
                inner_radius_px: 40.0,
                outer_radius_px: 140.0,
                eccentricity: 1.5,
                horizon_radius_px,
                ahead_rad: 0.0,
            })
        };
        assert_eq!(optics(mirror(0.0), Some((400, 300))), None);
        let known = optics(mirror(100.0), Some((400, 300))).unwrap();
        let panorama = known.panorama(grey(400, 300), 512).unwrap();
        assert_eq!(panorama.width(), 512);
        // Grey at the horizon, and rows at the edges that the ring does not reach.
        let row = |row: u32| panorama.pixels()[(row * 512 + 100) as usize];
        assert_eq!(row(panorama.height() / 2), 128);
        assert!(known.panorama(grey(300, 300), 512).is_err());
        let at = |y_px| Keypoint { x_px: 9.0, y_px, size_px: 3.0, angle_rad: 0.0, response: 1.0 };
        let middle = panorama.height() as f32 / 2.0;
        let keypoints = vec![at(0.0), at(middle), at(panorama.height() as f32 - 1.0)];
        let descriptors = fabmap::descriptor::Descriptors::new(
            fabmap::descriptor::DescriptorKind::Binary,
            1,
            vec![1, 2, 3],
        );
        let features = Features { keypoints, descriptors: descriptors.unwrap() };
        let kept = known.of_the_world(features, (panorama.width(), panorama.height()));
        assert!(kept.keypoints.contains(&at(middle)) && kept.keypoints.len() < 3, "{kept:?}");
        assert_eq!(kept.keypoints.len(), kept.descriptors.rows().count());
    }

    #[test]
    fn other_cameras_make_no_panoramas() {
        assert_eq!(optics(CameraModel::FieldOfView { horizontal_rad: 1.0 }, None), None);
    }
}
