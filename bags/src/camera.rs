//! What a `CameraInfo` says of the images that are sent.

use crate::messages::{CameraInfo, Pose};
use crate::rational::{MOST_ERROR_PX, fit};

/// A calibrated camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// How it projects.
    pub lens: Lens,
    /// Width and height of its images.
    pub size_px: (u32, u32),
    /// Pose of the camera in the robot's base: x where it looks, y to the left, z up. None if the bag does not say.
    pub base_to_camera: Option<Pose>,
}

/// How a camera projects, in pixels.
#[derive(Clone, Debug, PartialEq)]
pub enum Lens {
    /// Perspective, with Brown and Conrady's distortion (k1, k2, p1, p2, k3): none, 4 or 5 values.
    Pinhole(Intrinsics),
    /// Kannala and Brandt's fisheye (k1, k2, k3, k4): none or 4 values.
    Fisheye(Intrinsics),
}

/// Focal lengths, principal point and distortion.
#[derive(Clone, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal length along a row.
    pub fx_px: f64,
    /// Focal length along a column.
    pub fy_px: f64,
    /// Where the axis is in a row.
    pub cx_px: f64,
    /// Where the axis is in a column.
    pub cy_px: f64,
    /// As the lens says.
    pub distortion: Vec<f64>,
}

impl Intrinsics {
    fn matrix(&self) -> [f64; 4] {
        [self.fx_px, self.fy_px, self.cx_px, self.cy_px]
    }
}

/// Why a `CameraInfo` describes no camera that can be declared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Undeclared {
    /// Its numbers are 0, as of a camera that was never calibrated.
    #[error("it is not calibrated: its focal lengths are not above 0")]
    Uncalibrated,
    /// A distortion that there is no model for.
    #[error(
        "its distortion model `{0}` cannot be declared; plumb_bob and equidistant can, and rectified images"
    )]
    Model(String),
    /// The rational model with a denominator, to which plumb_bob is not near enough.
    #[error("its rational_polynomial has k4, k5 or k6, which cannot be declared{}; stream the rectified images", nearest(*.error_px))]
    Rational {
        /// How far the nearest plumb_bob is from it at most, in pixels; none where none was looked for or found.
        error_px: Option<f64>,
    },
    /// Too many or too few parameters.
    #[error("its distortion model `{model}` has {count} parameters")]
    Parameters {
        /// The model.
        model: String,
        /// How many it has.
        count: usize,
    },
}

fn nearest(error_px: Option<f64>) -> String {
    error_px.map_or_else(String::new, |error_px| {
        format!(
            ": the nearest plumb_bob is up to {error_px:.2} pixels from it, and {MOST_ERROR_PX} are allowed"
        )
    })
}

/// What the images of a topic are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rectification {
    /// As the camera took them.
    Raw,
    /// Without distortion, by the `CameraInfo`'s projection.
    Rectified,
}

impl Rectification {
    /// By the topic's name: `image_rect`, `image_rect_color`, `image_rect/compressed`.
    pub(crate) fn of(topic: &str) -> Self {
        let is_rectified = topic.split('/').any(|part| part.starts_with("image_rect"));
        if is_rectified { Rectification::Rectified } else { Rectification::Raw }
    }
}

impl CameraInfo {
    /// The camera of raw images.
    ///
    /// # Errors
    /// Why such a camera cannot be declared.
    pub fn declared(&self) -> Result<Camera, Undeclared> {
        camera(self, Rectification::Raw)
    }

    /// How far the plumb_bob that is declared of raw images is from the rational_polynomial that is meant, in pixels at most; none where
    /// what is meant is declared, or nothing.
    #[must_use]
    pub fn approximation_px(&self) -> Option<f64> {
        let meant = has_denominator(&self.distortion_model, &self.distortion)?;
        let Camera { lens: Lens::Pinhole(declared), size_px, .. } = self.declared().ok()? else {
            return None;
        };
        fit(meant, declared.matrix(), size_px).map(|fit| fit.error_px)
    }
}

/// The parameters of a rational model that is no plumb_bob.
fn has_denominator(model: &str, distortion: &[f64]) -> Option<[f64; 8]> {
    let parameters: [f64; 8] = distortion.try_into().ok()?;
    (model == "rational_polynomial" && parameters[5..].iter().any(|parameter| *parameter != 0.0))
        .then_some(parameters)
}

/// The camera that took the images.
pub(crate) fn camera(info: &CameraInfo, rectification: Rectification) -> Result<Camera, Undeclared> {
    let [fx_px, _, cx_px, _, fy_px, cy_px, ..] = info.intrinsics;
    let [rectified_fx_px, _, rectified_cx_px, _, _, rectified_fy_px, rectified_cy_px, ..] = info.projection;
    let rectified = [rectified_fx_px, rectified_fy_px, rectified_cx_px, rectified_cy_px];
    let (full, model, distortion) = match rectification {
        Rectification::Raw => {
            ([fx_px, fy_px, cx_px, cy_px], info.distortion_model.as_str(), info.distortion.as_slice())
        }
        Rectification::Rectified => (rectified, "plumb_bob", [].as_slice()),
    };
    let [left, upper, width, height] = info.region_px;
    let (across, down) = (info.binning.0.max(1), info.binning.1.max(1));
    let (width, height) = if width == 0 || height == 0 { info.size_px } else { (width, height) };
    let [full_fx_px, full_fy_px, full_cx_px, full_cy_px] = full;
    let of = |distortion: &[f64]| Intrinsics {
        fx_px: full_fx_px / f64::from(across),
        fy_px: full_fy_px / f64::from(down),
        cx_px: (full_cx_px - f64::from(left)) / f64::from(across),
        cy_px: (full_cy_px - f64::from(upper)) / f64::from(down),
        distortion: distortion.to_vec(),
    };
    let is_calibrated = full.iter().all(|value| value.is_finite()) && full_fx_px > 0.0 && full_fy_px > 0.0;
    if !is_calibrated || width == 0 || height == 0 {
        return Err(Undeclared::Uncalibrated);
    }
    let size_px = (width / across, height / down);
    let lens = match has_denominator(model, distortion) {
        None => lens(model, distortion, of)?,
        Some(meant) => match fit(meant, of(&[]).matrix(), size_px) {
            Some(fit) if fit.error_px < MOST_ERROR_PX => Lens::Pinhole(of(&fit.distortion)),
            far => return Err(Undeclared::Rational { error_px: far.map(|fit| fit.error_px) }),
        },
    };
    Ok(Camera { lens, size_px, base_to_camera: None })
}

pub(crate) fn lens(
    model: &str,
    distortion: &[f64],
    intrinsics: impl Fn(&[f64]) -> Intrinsics,
) -> Result<Lens, Undeclared> {
    match (model, distortion) {
        ("plumb_bob" | "rational_polynomial" | "", []) => Ok(Lens::Pinhole(intrinsics(&[]))),
        ("plumb_bob", [_, _, _, _] | [_, _, _, _, _]) => Ok(Lens::Pinhole(intrinsics(distortion))),
        ("rational_polynomial", [numerator @ .., k4, k5, k6]) if numerator.len() == 5 => {
            let has_denominator = [k4, k5, k6].iter().any(|parameter| **parameter != 0.0);
            if has_denominator {
                Err(Undeclared::Rational { error_px: None })
            } else {
                Ok(Lens::Pinhole(intrinsics(numerator)))
            }
        }
        ("equidistant" | "fisheye", [] | [_, _, _, _]) => Ok(Lens::Fisheye(intrinsics(distortion))),
        ("plumb_bob" | "rational_polynomial" | "equidistant" | "fisheye", _) => {
            Err(Undeclared::Parameters { model: model.to_owned(), count: distortion.len() })
        }
        (other, _) => Err(Undeclared::Model(other.to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info(model: &str, distortion: &[f64]) -> CameraInfo {
        CameraInfo {
            frame_id: "camera_optical".to_owned(),
            size_px: (640, 480),
            distortion_model: model.to_owned(),
            distortion: distortion.to_vec(),
            intrinsics: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0],
            projection: [400.0, 0.0, 310.0, 0.0, 0.0, 410.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            binning: (0, 0),
            region_px: [0; 4],
        }
    }

    fn pinhole(info: &CameraInfo, rectification: Rectification) -> Intrinsics {
        match camera(info, rectification).unwrap().lens {
            Lens::Pinhole(intrinsics) => intrinsics,
            Lens::Fisheye(intrinsics) => panic!("{intrinsics:?}"),
        }
    }

    #[test]
    fn raw_images_have_the_raw_intrinsics_and_rectified_ones_the_projection() {
        let info = info("plumb_bob", &[0.1, 0.2, 0.0, 0.0, 0.3]);
        let raw = pinhole(&info, Rectification::of("/camera/image_raw/compressed"));
        assert_eq!((raw.fx_px, raw.fy_px, raw.cx_px, raw.cy_px), (500.0, 510.0, 320.0, 240.0));
        assert_eq!(raw.distortion, [0.1, 0.2, 0.0, 0.0, 0.3]);
        let rectified = pinhole(&info, Rectification::of("/camera/image_rect_color"));
        assert_eq!((rectified.fx_px, rectified.fy_px), (400.0, 410.0));
        assert_eq!((rectified.cx_px, rectified.cy_px, rectified.distortion.len()), (310.0, 230.0, 0));
    }

    #[test]
    fn binning_and_region_are_of_the_full_image() {
        let mut info = info("plumb_bob", &[]);
        (info.binning, info.region_px) = ((2, 2), [100, 40, 400, 300]);
        let binned = pinhole(&info, Rectification::Raw);
        assert_eq!((binned.fx_px, binned.fy_px, binned.cx_px, binned.cy_px), (250.0, 255.0, 110.0, 100.0));
        assert_eq!(camera(&info, Rectification::Raw).unwrap().size_px, (200, 150));
    }

    #[test]
    fn what_cannot_be_declared_is_said() {
        let of = |model, distortion: &[f64]| camera(&info(model, distortion), Rectification::Raw);
        assert!(matches!(of("equidistant", &[0.1; 4]).unwrap().lens, Lens::Fisheye(_)));
        let five = of("rational_polynomial", &[0.1, 0.1, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0]).unwrap();
        assert!(matches!(five.lens, Lens::Pinhole(intrinsics) if intrinsics.distortion.len() == 5));
        let near = of("rational_polynomial", &[0.3, -0.1, 0.0, 0.0, 0.01, 0.25, -0.05, 0.0]).unwrap();
        assert!(matches!(near.lens, Lens::Pinhole(intrinsics) if intrinsics.distortion.len() == 5));
        let folds = of("rational_polynomial", &[-3.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0]).unwrap_err();
        assert_eq!(folds, Undeclared::Rational { error_px: None });
        let far = Undeclared::Rational { error_px: Some(1.234) }.to_string();
        assert!(
            far.contains("the nearest plumb_bob is up to 1.23 pixels from it, and 0.5 are allowed"),
            "{far}"
        );
        assert_eq!(of("thin_prism", &[0.1; 8]), Err(Undeclared::Model("thin_prism".to_owned())));
        let count = Undeclared::Parameters { model: "plumb_bob".to_owned(), count: 3 };
        assert_eq!(of("plumb_bob", &[0.1; 3]), Err(count));
        let mut blank = info("plumb_bob", &[]);
        blank.intrinsics = [0.0; 9];
        assert_eq!(camera(&blank, Rectification::Raw), Err(Undeclared::Uncalibrated));
        assert!(camera(&blank, Rectification::Rectified).is_ok());
    }
}
