//! Cameras as robots declare them: checked here, kept with the session, used where geometry is.

mod panoramic;

use prost::Message;
use topomap::odometry::{Odometry, OdometryError};
use waypost_proto::v1;
use waypost_proto::v1::camera::Model;
use waypost_vision::verification::{Distortion, Pinhole};

pub(crate) use self::panoramic::PanoramicOptics;
use crate::error::ServiceError;

/// How a robot sees; lengths in pixels of the images it sends.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Camera {
    pub(crate) model: Option<CameraModel>,
    pub(crate) image_size_px: Option<(u32, u32)>,
    /// Pose of the camera in `base_link`: position in metres, orientation x, y, z, w.
    pub(crate) base_to_camera: Option<([f64; 3], [f64; 4])>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum CameraModel {
    Pinhole {
        focal_px: [f64; 2],
        center_px: [f64; 2],
        distortion: Vec<f64>,
    },
    FieldOfView {
        horizontal_rad: f64,
    },
    Fisheye {
        focal_px: [f64; 2],
        center_px: [f64; 2],
        distortion: Vec<f64>,
    },
    Cylindrical {
        vertical_rad: f64,
    },
    Equirectangular {
        vertical_rad: Option<f64>,
    },
    HyperbolicMirror {
        center_px: [f64; 2],
        inner_radius_px: f64,
        outer_radius_px: f64,
        eccentricity: f64,
        /// 0 if it is not known.
        horizon_radius_px: f64,
        ahead_rad: f64,
    },
}

impl Camera {
    /// Refuses what no camera is, naming the field.
    pub(crate) fn check(&self) -> Result<(), ServiceError> {
        if let Some((width, height)) = self.image_size_px
            && (width == 0 || height == 0)
        {
            return Err(ServiceError::invalid(
                "the camera's image size needs width and height above 0, or neither",
            ));
        }
        if let Some((position_m, orientation)) = self.base_to_camera {
            Odometry::new(position_m, orientation, None).map_err(|error| match error {
                OdometryError::NotFinite { .. } => {
                    ServiceError::invalid("the camera's pose is not finite; send metres, or leave it out")
                }
                OdometryError::NotUnit { norm } => ServiceError::invalid(format_args!(
                    "the camera's orientation has length {norm}; send a unit quaternion (x, y, z, w)"
                )),
                OdometryError::TooFar { value } => ServiceError::invalid(format_args!(
                    "the camera is {value} m from base_link; send metres, or leave its pose out"
                )),
                OdometryError::NotACovariance | OdometryError::TooUnsure { .. } => {
                    ServiceError::internal("a camera has no covariance")
                }
            })?;
        }
        self.model.as_ref().map_or(Ok(()), CameraModel::check)
    }
}

impl CameraModel {
    fn check(&self) -> Result<(), ServiceError> {
        match self {
            CameraModel::Pinhole { focal_px, center_px, distortion } => {
                check_intrinsics(*focal_px, *center_px, distortion, &[0, 4, 5])
            }
            CameraModel::Fisheye { focal_px, center_px, distortion } => {
                check_intrinsics(*focal_px, *center_px, distortion, &[0, 4])
            }
            CameraModel::FieldOfView { horizontal_rad } => {
                check_angle("horizontal field of view", *horizontal_rad)
            }
            CameraModel::Cylindrical { vertical_rad } => {
                check_angle("vertical angle of the cylinder", *vertical_rad)
            }
            CameraModel::Equirectangular { vertical_rad: None } => Ok(()),
            CameraModel::Equirectangular { vertical_rad: Some(angle) } => {
                let fits = *angle > 0.0 && *angle <= std::f64::consts::PI;
                require(fits, || {
                    format!("the panorama's vertical angle must be above 0 and at most pi, not {angle} rad")
                })
            }
            CameraModel::HyperbolicMirror {
                center_px,
                inner_radius_px,
                outer_radius_px,
                eccentricity,
                horizon_radius_px,
                ahead_rad,
            } => {
                require(center_px.iter().all(|c| c.is_finite()), || {
                    "the mirror's centre is not finite".to_owned()
                })?;
                let radii = *inner_radius_px >= 0.0
                    && outer_radius_px > inner_radius_px
                    && outer_radius_px.is_finite();
                require(radii, || {
                    format!(
                        "the mirror's radii must be 0 <= inner < outer, not {inner_radius_px} and {outer_radius_px} px"
                    )
                })?;
                let hyperbola = *eccentricity > 1.0 && eccentricity.is_finite();
                require(hyperbola, || {
                    format!("the mirror's eccentricity must be above 1, not {eccentricity}")
                })?;
                let known = *horizon_radius_px >= 0.0 && horizon_radius_px.is_finite();
                require(known, || {
                    format!(
                        "the mirror's horizon must be seen at a radius above 0, not {horizon_radius_px} px; leave it \
                         out if it is not known"
                    )
                })?;
                require(ahead_rad.is_finite(), || {
                    format!(
                        "ahead lies at {ahead_rad} rad in the mirror's image; send radians, or leave it out"
                    )
                })
            }
        }
    }
}

fn check_intrinsics(
    focal_px: [f64; 2],
    center_px: [f64; 2],
    distortion: &[f64],
    lengths: &[usize],
) -> Result<(), ServiceError> {
    require(focal_px.iter().all(|f| *f > 0.0 && f.is_finite()), || {
        format!("the camera's focal lengths must be above 0 px, not {} and {}", focal_px[0], focal_px[1])
    })?;
    require(center_px.iter().all(|c| c.is_finite()), || {
        "the camera's centre is not finite; send pixels".to_owned()
    })?;
    require(lengths.contains(&distortion.len()), || {
        format!("this camera model takes {lengths:?} distortion values, not {}", distortion.len())
    })?;
    require(distortion.iter().all(|d| d.is_finite()), || "the camera's distortion is not finite".to_owned())
}

fn check_angle(what: &str, angle_rad: f64) -> Result<(), ServiceError> {
    let fits = angle_rad > 0.0 && angle_rad < std::f64::consts::PI;
    require(fits, || format!("the {what} must lie between 0 and pi, not {angle_rad} rad; send radians"))
}

fn require(holds: bool, message: impl FnOnce() -> String) -> Result<(), ServiceError> {
    if holds { Ok(()) } else { Err(ServiceError::invalid(message())) }
}

/// What geometry can use of a camera: how a perspective one turns pixels into rays. Cameras of other kinds have no
/// essential matrix in pixels, and are treated as unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Intrinsics {
    lens: Lens,
    /// Size of the images that they are for; those that are sent, if it was not declared.
    image_size_px: Option<(u32, u32)>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Lens {
    Calibrated(Pinhole),
    FieldOfView { horizontal_rad: f64 },
}

/// Images whose sides are in another proportion, by more than rounding, are not the declared ones made smaller.
const MAX_STRETCH: f64 = 0.02;

impl Intrinsics {
    /// Of a camera as sessions keep it, an encoded `waypost.v1.Camera`.
    pub(crate) fn of_camera(encoded: &[u8]) -> Option<Self> {
        // It was checked when the session was opened.
        let camera = v1::Camera::decode(encoded).ok()?;
        let lens = match camera.model? {
            Model::Pinhole(v1::Pinhole { fx_px, fy_px, cx_px, cy_px, distortion }) => {
                let coefficient = |index: usize| distortion.get(index).copied().unwrap_or(0.0);
                let radial = [coefficient(0), coefficient(1), coefficient(4)];
                let distortion = Distortion { radial, tangential: [coefficient(2), coefficient(3)] };
                Lens::Calibrated(Pinhole { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion })
            }
            Model::FieldOfView(v1::FieldOfView { horizontal_rad }) => Lens::FieldOfView { horizontal_rad },
            Model::Fisheye(_) | Model::Panorama(_) | Model::HyperbolicMirror(_) => return None,
        };
        let size = (camera.image_width_px, camera.image_height_px);
        Some(Self { lens, image_size_px: (size != (0, 0)).then_some(size) })
    }

    /// The camera as it took an image of that width and height, in pixels of it. None if that is no image of the
    /// declared size made smaller or larger.
    pub(crate) fn of_image(&self, size_px: (u32, u32)) -> Option<Pinhole> {
        let declared_px = self.image_size_px.unwrap_or(size_px);
        let factor = |to: u32, from: u32| f64::from(to) / f64::from(from);
        let stretch = factor(size_px.0, declared_px.0) / factor(size_px.1, declared_px.1);
        if (stretch - 1.0).abs() > MAX_STRETCH {
            return None;
        }
        Some(match self.lens {
            Lens::Calibrated(pinhole) => pinhole.resized(declared_px, size_px),
            Lens::FieldOfView { horizontal_rad } => Pinhole::of_field_of_view(horizontal_rad, size_px),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded(model: Model, (image_width_px, image_height_px): (u32, u32)) -> Vec<u8> {
        v1::Camera { model: Some(model), image_width_px, image_height_px, base_to_camera: None }
            .encode_to_vec()
    }

    #[test]
    fn intrinsics_follow_the_size_of_the_image() {
        let distortion = vec![0.1, 0.2, 0.3, 0.4, 0.5];
        let pinhole = v1::Pinhole { fx_px: 500.0, fy_px: 490.0, cx_px: 319.5, cy_px: 239.5, distortion };
        let intrinsics = Intrinsics::of_camera(&encoded(Model::Pinhole(pinhole), (640, 480))).unwrap();
        let halved = intrinsics.of_image((320, 240)).unwrap();
        assert_eq!((halved.focal_px, halved.center_px), ([250.0, 245.0], [159.5, 119.5]));
        assert_eq!(halved.distortion, Distortion { radial: [0.1, 0.2, 0.5], tangential: [0.3, 0.4] });
        // Rounded sides are taken, another shape is not.
        assert!(intrinsics.of_image((213, 160)).is_some());
        assert_eq!(intrinsics.of_image((640, 360)), None);
        let view = Model::FieldOfView(v1::FieldOfView { horizontal_rad: std::f64::consts::FRAC_PI_2 });
        let wide = Intrinsics::of_camera(&encoded(view, (0, 0))).unwrap().of_image((200, 100)).unwrap();
        assert!((wide.focal_px[0] - 100.0).abs() < 1e-9 && wide.center_px == [99.5, 49.5]);
        let fisheye =
            v1::Fisheye { fx_px: 300.0, fy_px: 300.0, cx_px: 160.0, cy_px: 120.0, distortion: vec![] };
        assert_eq!(Intrinsics::of_camera(&encoded(Model::Fisheye(fisheye), (0, 0))), None);
    }

    fn check(model: CameraModel) -> Result<(), ServiceError> {
        Camera { model: Some(model), ..Camera::default() }.check()
    }

    fn pinhole(fx: f64, distortion: Vec<f64>) -> CameraModel {
        CameraModel::Pinhole { focal_px: [fx, 500.0], center_px: [320.0, 240.0], distortion }
    }

    #[test]
    fn cameras_that_exist_are_taken() {
        assert_eq!(Camera::default().check(), Ok(()));
        assert_eq!(check(pinhole(500.0, vec![0.1; 5])), Ok(()));
        assert_eq!(check(CameraModel::FieldOfView { horizontal_rad: 1.2 }), Ok(()));
        assert_eq!(check(CameraModel::Equirectangular { vertical_rad: None }), Ok(()));
    }

    #[test]
    fn cameras_that_do_not_exist_are_refused() {
        let mirror = |inner, outer, eccentricity, horizon, ahead| CameraModel::HyperbolicMirror {
            center_px: [0.0; 2],
            inner_radius_px: inner,
            outer_radius_px: outer,
            eccentricity,
            horizon_radius_px: horizon,
            ahead_rad: ahead,
        };
        assert_eq!(check(mirror(5.0, 10.0, 1.2, 0.0, 0.0)), Ok(()));
        let impossible = [
            pinhole(0.0, vec![]),
            pinhole(f64::NAN, vec![]),
            pinhole(500.0, vec![0.0; 3]),
            pinhole(500.0, vec![f64::NAN; 4]),
            CameraModel::FieldOfView { horizontal_rad: 90.0 },
            CameraModel::Cylindrical { vertical_rad: 0.0 },
            mirror(10.0, 5.0, 1.2, 8.0, 0.0),
            mirror(5.0, 10.0, 0.9, 8.0, 0.0),
            mirror(5.0, 10.0, 1.2, -8.0, 0.0),
            mirror(5.0, 10.0, 1.2, f64::INFINITY, 0.0),
            mirror(5.0, 10.0, 1.2, 8.0, f64::NAN),
        ];
        for model in impossible {
            assert!(matches!(check(model.clone()), Err(ServiceError::InvalidArgument { .. })), "{model:?}");
        }
        let pose = Camera { base_to_camera: Some(([0.0; 3], [0.0; 4])), ..Camera::default() };
        assert!(pose.check().is_err());
        assert!(Camera { image_size_px: Some((640, 0)), ..Camera::default() }.check().is_err());
    }
}
