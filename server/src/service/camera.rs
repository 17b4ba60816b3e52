//! Cameras as robots declare them: checked here, kept with the session, used where geometry is.

use topomap::odometry::{Odometry, OdometryError};

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
    Pinhole { focal_px: [f64; 2], center_px: [f64; 2], distortion: Vec<f64> },
    FieldOfView { horizontal_rad: f64 },
    Fisheye { focal_px: [f64; 2], center_px: [f64; 2], distortion: Vec<f64> },
    Cylindrical { vertical_rad: f64 },
    Equirectangular { vertical_rad: Option<f64> },
    HyperbolicMirror { center_px: [f64; 2], inner_radius_px: f64, outer_radius_px: f64, eccentricity: f64 },
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
                OdometryError::NotACovariance => ServiceError::internal("a camera has no covariance"),
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
            CameraModel::HyperbolicMirror { center_px, inner_radius_px, outer_radius_px, eccentricity } => {
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

#[cfg(test)]
mod tests {
    use super::*;

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
        let mirror = |inner, outer, eccentricity| CameraModel::HyperbolicMirror {
            center_px: [0.0; 2],
            inner_radius_px: inner,
            outer_radius_px: outer,
            eccentricity,
        };
        let impossible = [
            pinhole(0.0, vec![]),
            pinhole(f64::NAN, vec![]),
            pinhole(500.0, vec![0.0; 3]),
            pinhole(500.0, vec![f64::NAN; 4]),
            CameraModel::FieldOfView { horizontal_rad: 90.0 },
            CameraModel::Cylindrical { vertical_rad: 0.0 },
            mirror(10.0, 5.0, 1.2),
            mirror(5.0, 10.0, 0.9),
        ];
        for model in impossible {
            assert!(matches!(check(model.clone()), Err(ServiceError::InvalidArgument { .. })), "{model:?}");
        }
        let pose = Camera { base_to_camera: Some(([0.0; 3], [0.0; 4])), ..Camera::default() };
        assert!(pose.check().is_err());
        assert!(Camera { image_size_px: Some((640, 0)), ..Camera::default() }.check().is_err());
    }
}
