//! Cameras as robots declare them, kept with their sessions.

mod bytes;
mod message;

use std::f64::consts::PI;

use topomap::metric::{Odometry, OdometryError};

pub(crate) use self::message::from_message;

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
    HyperbolicMirror(Mirror),
}

/// A camera that looks up into a hyperbolic mirror.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Mirror {
    pub(crate) center_px: [f64; 2],
    pub(crate) inner_radius_px: f64,
    pub(crate) outer_radius_px: f64,
    pub(crate) eccentricity: f64,
    /// 0 if it is not known.
    pub(crate) horizon_radius_px: f64,
    pub(crate) ahead_rad: f64,
}

/// Why a camera is none.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum CameraError {
    #[error("the camera's image size needs width and height above 0, or neither")]
    ImageSize,
    #[error("the camera's pose is not finite; send metres, or leave it out")]
    PoseNotFinite,
    #[error("the camera's orientation has length {norm}; send a unit quaternion (x, y, z, w)")]
    Orientation { norm: f64 },
    #[error("the camera is {value} m from base_link; send metres, or leave its pose out")]
    TooFar { value: f64 },
    #[error("the camera's focal lengths must be above 0 px, not {} and {}", focal_px[0], focal_px[1])]
    FocalLengths { focal_px: [f64; 2] },
    #[error("the camera's centre is not finite; send pixels")]
    Center,
    #[error("this camera model takes {takes:?} distortion values, not {found}")]
    DistortionCount { takes: &'static [usize], found: usize },
    #[error("the camera's distortion is not finite")]
    Distortion,
    #[error("the {what} must lie between 0 and pi, not {angle_rad} rad; send radians")]
    Angle { what: &'static str, angle_rad: f64 },
    #[error("the panorama's vertical angle must be above 0 and at most pi, not {angle_rad} rad")]
    PanoramaAngle { angle_rad: f64 },
    #[error("the mirror's centre is not finite")]
    MirrorCenter,
    #[error("the mirror's radii must be 0 <= inner < outer, not {inner_px} and {outer_px} px")]
    MirrorRadii { inner_px: f64, outer_px: f64 },
    #[error("the mirror's eccentricity must be above 1, not {eccentricity}")]
    Eccentricity { eccentricity: f64 },
    #[error(
        "the mirror's horizon must be seen at a radius above 0, not {radius_px} px; leave it out if it is not known"
    )]
    Horizon { radius_px: f64 },
    #[error("ahead lies at {ahead_rad} rad in the mirror's image; send radians, or leave it out")]
    Ahead { ahead_rad: f64 },
}

impl Camera {
    /// Refuses what no camera is, naming the field.
    pub(crate) fn check(&self) -> Result<(), CameraError> {
        if let Some((width, height)) = self.image_size_px {
            require(width > 0 && height > 0, CameraError::ImageSize)?;
        }
        if let Some((position_m, orientation)) = self.base_to_camera {
            check_pose(position_m, orientation)?;
        }
        self.model.as_ref().map_or(Ok(()), CameraModel::check)
    }
}

impl CameraModel {
    fn check(&self) -> Result<(), CameraError> {
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
            CameraModel::Equirectangular { vertical_rad } => match *vertical_rad {
                Some(angle_rad) if !(angle_rad > 0.0 && angle_rad <= PI) => {
                    Err(CameraError::PanoramaAngle { angle_rad })
                }
                Some(_) | None => Ok(()),
            },
            CameraModel::HyperbolicMirror(mirror) => mirror.check(),
        }
    }
}

impl Mirror {
    fn check(&self) -> Result<(), CameraError> {
        let Self {
            center_px,
            inner_radius_px: inner_px,
            outer_radius_px: outer_px,
            eccentricity,
            horizon_radius_px: radius_px,
            ahead_rad,
        } = *self;
        require(center_px.iter().all(|c| c.is_finite()), CameraError::MirrorCenter)?;
        let rising = inner_px >= 0.0 && outer_px > inner_px && outer_px.is_finite();
        require(rising, CameraError::MirrorRadii { inner_px, outer_px })?;
        let hyperbola = eccentricity > 1.0 && eccentricity.is_finite();
        require(hyperbola, CameraError::Eccentricity { eccentricity })?;
        require(radius_px >= 0.0 && radius_px.is_finite(), CameraError::Horizon { radius_px })?;
        require(ahead_rad.is_finite(), CameraError::Ahead { ahead_rad })
    }
}

fn check_pose(position_m: [f64; 3], orientation: [f64; 4]) -> Result<(), CameraError> {
    match Odometry::new(position_m, orientation, None) {
        // There is no covariance that could be wrong.
        Ok(_) | Err(OdometryError::NotACovariance | OdometryError::TooUnsure { .. }) => Ok(()),
        Err(OdometryError::NotFinite { .. }) => Err(CameraError::PoseNotFinite),
        Err(OdometryError::NotUnit { norm }) => Err(CameraError::Orientation { norm }),
        Err(OdometryError::TooFar { value }) => Err(CameraError::TooFar { value }),
    }
}

fn check_intrinsics(
    focal_px: [f64; 2],
    center_px: [f64; 2],
    distortion: &[f64],
    takes: &'static [usize],
) -> Result<(), CameraError> {
    require(focal_px.iter().all(|f| *f > 0.0 && f.is_finite()), CameraError::FocalLengths { focal_px })?;
    require(center_px.iter().all(|c| c.is_finite()), CameraError::Center)?;
    let found = distortion.len();
    require(takes.contains(&found), CameraError::DistortionCount { takes, found })?;
    require(distortion.iter().all(|d| d.is_finite()), CameraError::Distortion)
}

fn check_angle(what: &'static str, angle_rad: f64) -> Result<(), CameraError> {
    require(angle_rad > 0.0 && angle_rad < PI, CameraError::Angle { what, angle_rad })
}

fn require(holds: bool, error: CameraError) -> Result<(), CameraError> {
    if holds { Ok(()) } else { Err(error) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(model: CameraModel) -> Result<(), CameraError> {
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
        let mirror = |inner_radius_px, outer_radius_px, eccentricity, horizon_radius_px, ahead_rad| {
            CameraModel::HyperbolicMirror(Mirror {
                center_px: [0.0; 2],
                inner_radius_px,
                outer_radius_px,
                eccentricity,
                horizon_radius_px,
                ahead_rad,
            })
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
            assert!(check(model.clone()).is_err(), "{model:?}");
        }
        let pose = Camera { base_to_camera: Some(([0.0; 3], [0.0; 4])), ..Camera::default() };
        assert!(pose.check().is_err());
        assert!(Camera { image_size_px: Some((640, 0)), ..Camera::default() }.check().is_err());
    }
}
