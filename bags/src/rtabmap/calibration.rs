//! Calibrations of nodes: models with a head since 0.18, before that 32-bit floats alone.

use super::matrix::{self, pose_of_bytes};
use crate::bytes::{Malformed, Reader};
use crate::camera::{Camera, Intrinsics, Undeclared, lens};
use crate::transforms::in_optical_frame;

/// Why a session's camera cannot be declared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoCamera {
    /// Nothing was kept of it.
    #[error("its nodes have no calibration")]
    Missing,
    /// It is not as RTAB-Map writes it.
    #[error("its calibration cannot be read {0}")]
    Malformed(#[from] Malformed),
    /// As long as no calibration.
    #[error("its calibration has {0} bytes, which fits no form that RTAB-Map wrote")]
    Length(usize),
    /// A kind of camera that newer versions may have.
    #[error("its calibration is of kind {0}; mono (0) and stereo (1) are read")]
    Kind(i32),
    /// It describes a camera that there is no model for.
    #[error(transparent)]
    Undeclared(#[from] Undeclared),
    /// It is of other images.
    #[error(
        "its calibration is for images of {} x {} pixels, and the first has {} x {}", calibrated_px.0, calibrated_px.1,
        image_px.0, image_px.1
    )]
    Size {
        /// Of the calibration.
        calibrated_px: (u32, u32),
        /// Of the first image.
        image_px: (u32, u32),
    },
}

/// What the images of a database are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Images {
    /// Seen as by a camera without distortion.
    Rectified,
    /// As the camera took them.
    Raw,
}

/// The cameras of a node.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Calibration {
    /// The left one of a stereo camera; several have their images side by side.
    pub(super) models: Vec<Model>,
    pub(super) is_stereo: bool,
}

/// A camera as RTAB-Map describes it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Model {
    /// Zeros where it is not said.
    size_px: (u32, u32),
    /// fx, fy, cx, cy of images as they were taken, and their distortion.
    raw: Option<([f64; 4], Vec<f64>)>,
    /// fx, fy, cx, cy of rectified images.
    rectified: Option<[f64; 4]>,
    /// The optical frame in the robot's base.
    local_transform: Vec<u8>,
}

const MONO: i32 = 0;
const STEREO: i32 = 1;

/// Cameras of more nodes than that are not side by side in any image.
const MOST_CAMERAS: usize = 64;

/// Calibrations with a head, of 0.18 and later.
pub(super) fn with_head(bytes: &[u8]) -> Result<Calibration, NoCamera> {
    let mut reader = Reader::packed(bytes);
    let (mut models, mut is_stereo) = (Vec::new(), false);
    while !reader.is_at_end() && models.len() < MOST_CAMERAS {
        let _version: [i32; 3] = [reader.i32()?, reader.i32()?, reader.i32()?];
        match reader.i32()? {
            MONO => models.push(mono(&mut reader)?),
            STEREO => {
                is_stereo = true;
                models.push(stereo(&mut reader)?);
            }
            other => return Err(NoCamera::Kind(other)),
        }
    }
    if models.is_empty() { Err(NoCamera::Missing) } else { Ok(Calibration { models, is_stereo }) }
}

/// The rest of a model, behind its version and kind.
fn mono(reader: &mut Reader<'_>) -> Result<Model, NoCamera> {
    let size_px = (reader.u32()?, reader.u32()?);
    let [k, d, r, p, local] = counts(reader)?;
    let matrix = numbers(reader, k)?;
    let distortion = numbers(reader, d)?;
    let _rectification = reader.take(r.saturating_mul(8))?;
    let projection = numbers(reader, p)?;
    let local_transform = reader.take(local.saturating_mul(4))?.to_vec();
    let raw = match matrix.as_slice() {
        &[fx, _, cx, _, fy, cy, ..] => Some(([fx, fy, cx, cy], distortion)),
        _ => None,
    };
    let rectified = match projection.as_slice() {
        &[fx, _, cx, _, _, fy, cy, ..] => Some([fx, fy, cx, cy]),
        _ => None,
    };
    Ok(Model { size_px, raw, rectified, local_transform })
}

/// The left one of two cameras, behind their version and kind.
fn stereo(reader: &mut Reader<'_>) -> Result<Model, NoCamera> {
    let [r, t, e, f, left, right] = counts(reader)?;
    for count in [r, t, e, f] {
        reader.take(count.saturating_mul(8))?;
    }
    let left = with_head(reader.take(left)?)?;
    reader.take(right)?;
    left.models.into_iter().next().ok_or(NoCamera::Missing)
}

fn counts<const COUNT: usize>(reader: &mut Reader<'_>) -> Result<[usize; COUNT], Malformed> {
    let mut counts = [0; COUNT];
    for count in &mut counts {
        // One that is negative is longer than anything.
        *count = usize::try_from(reader.i32()?).unwrap_or(usize::MAX);
    }
    Ok(counts)
}

fn numbers(reader: &mut Reader<'_>, count: usize) -> Result<Vec<f64>, Malformed> {
    let mut part = Reader::packed(reader.take(count.saturating_mul(8))?);
    (0..count).map(|_| part.f64()).collect()
}

/// Calibrations of 0.17: fx, fy, cx, cy, width, height and the transform for each camera; of stereo with the baseline
/// before the size, or without a size.
pub(super) fn without_head(bytes: &[u8]) -> Result<Calibration, NoCamera> {
    const MONO_BYTES: usize = 6 * 4 + matrix::BYTES;
    const STEREO_BYTES: usize = 7 * 4 + matrix::BYTES;
    const STEREO_WITHOUT_SIZE_BYTES: usize = 5 * 4 + matrix::BYTES;
    let model = |part: &[u8], numbers: usize| -> Model {
        let at = |index: usize| f32::from_le_bytes(std::array::from_fn(|byte| part[index * 4 + byte]));
        let size_px = if numbers > 5 { (at(numbers - 2), at(numbers - 1)) } else { (0.0, 0.0) };
        Model {
            // A float that is no size becomes one that fits no image.
            size_px: (size_px.0 as u32, size_px.1 as u32),
            raw: None,
            rectified: Some(std::array::from_fn(|index| f64::from(at(index)))),
            local_transform: part[numbers * 4..].to_vec(),
        }
    };
    match bytes.len() {
        0 => Err(NoCamera::Missing),
        STEREO_BYTES => Ok(Calibration { models: vec![model(bytes, 7)], is_stereo: true }),
        STEREO_WITHOUT_SIZE_BYTES => Ok(Calibration { models: vec![model(bytes, 5)], is_stereo: true }),
        length if length.is_multiple_of(MONO_BYTES) && length / MONO_BYTES <= MOST_CAMERAS => {
            let models = bytes.chunks_exact(MONO_BYTES).map(|part| model(part, 6)).collect();
            Ok(Calibration { models, is_stereo: false })
        }
        other => Err(NoCamera::Length(other)),
    }
}

impl Model {
    /// The camera of images of a size.
    pub(super) fn declared(&self, images: Images, image_px: (u32, u32)) -> Result<Camera, NoCamera> {
        let (intrinsics, distortion) = match (images, self.rectified, &self.raw) {
            (Images::Rectified, Some(rectified), _) | (Images::Raw, Some(rectified), None) => {
                (rectified, [].as_slice())
            }
            (Images::Raw | Images::Rectified, _, Some((raw, distortion))) => (*raw, distortion.as_slice()),
            (Images::Rectified, None, None) | (Images::Raw, None, None) => return Err(NoCamera::Missing),
        };
        let [fx_px, fy_px, cx_px, cy_px] = intrinsics;
        if !intrinsics.iter().all(|value| value.is_finite()) || fx_px <= 0.0 || fy_px <= 0.0 {
            return Err(Undeclared::Uncalibrated.into());
        }
        let (model, distortion) = as_ros(distortion);
        let of =
            |distortion: &[f64]| Intrinsics { fx_px, fy_px, cx_px, cy_px, distortion: distortion.to_vec() };
        let lens = lens(model, &distortion, of)?;
        let base_to_camera = pose_of_bytes(&self.local_transform).map(in_optical_frame);
        Ok(Camera { lens, size_px: self.size(image_px)?, base_to_camera })
    }

    /// Images may have been made smaller, but not cut off.
    fn size(&self, image_px: (u32, u32)) -> Result<(u32, u32), NoCamera> {
        let ((width, height), (image_width, image_height)) = (self.size_px, image_px);
        if width == 0 || height == 0 {
            return Ok(image_px);
        }
        let [across, down] =
            [u64::from(width) * u64::from(image_height), u64::from(image_width) * u64::from(height)];
        if across.abs_diff(down) > u64::from(width.max(height)) {
            return Err(NoCamera::Size { calibrated_px: self.size_px, image_px });
        }
        Ok(self.size_px)
    }
}

/// RTAB-Map has OpenCV's parameters, and k1, k2, 0, 0, k3, k4 of a fisheye.
fn as_ros(distortion: &[f64]) -> (&'static str, Vec<f64>) {
    match distortion {
        parameters if parameters.iter().all(|parameter| *parameter == 0.0) && parameters.len() != 6 => {
            ("plumb_bob", Vec::new())
        }
        &[k1, k2, _, _, k3, k4] => ("equidistant", vec![k1, k2, k3, k4]),
        [rational @ .., s1, s2, s3, s4]
            if rational.len() == 8 && [s1, s2, s3, s4].iter().all(|part| **part == 0.0) =>
        {
            ("rational_polynomial", rational.to_vec())
        }
        rational if rational.len() == 8 => ("rational_polynomial", rational.to_vec()),
        short if short.len() <= 5 => ("plumb_bob", short.to_vec()),
        long => ("thin prism", long.to_vec()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Lens;

    const OPTICAL: [f32; 12] = [0.0, 0.0, 1.0, 0.2, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.3];

    fn local_transform() -> Vec<u8> {
        OPTICAL.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        let values = values.iter().flat_map(|value| value.to_le_bytes());
        values.chain(local_transform()).collect()
    }

    fn mono_model(distortion: &[f64], projection: &[f64]) -> Vec<u8> {
        let matrix = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0];
        let head = [0, 20, 0, MONO, 640, 480, 9, distortion.len() as i32, 0, projection.len() as i32, 12];
        let head = head.iter().flat_map(|value| value.to_le_bytes());
        let numbers = matrix.iter().chain(distortion).chain(projection).flat_map(|value| value.to_le_bytes());
        head.chain(numbers).chain(local_transform()).collect()
    }

    fn pinhole(model: &Model, images: Images) -> Intrinsics {
        match model.declared(images, (640, 480)).unwrap().lens {
            Lens::Pinhole(intrinsics) => intrinsics,
            Lens::Fisheye(intrinsics) => panic!("{intrinsics:?}"),
        }
    }

    #[test]
    fn floats_alone_are_of_one_several_or_two_cameras() {
        let one = [400.0, 410.0, 310.0, 230.0, 640.0, 480.0];
        let read = without_head(&floats(&one)).unwrap();
        assert!(!read.is_stereo && read.models.len() == 1);
        let camera = read.models[0].declared(Images::Rectified, (640, 480)).unwrap();
        assert_eq!(camera.size_px, (640, 480));
        let mount = camera.base_to_camera.unwrap();
        // Ahead, as the robot itself.
        assert!(mount.orientation[3].abs() > 0.999 && (mount.position_m[2] - 0.3).abs() < 1e-6, "{mount:?}");
        let several = without_head(&[floats(&one), floats(&one)].concat()).unwrap();
        assert_eq!((several.models.len(), several.is_stereo), (2, false));
        let stereo = without_head(&floats(&[400.0, 410.0, 310.0, 230.0, 0.1, 640.0, 480.0])).unwrap();
        assert_eq!((stereo.models[0].size_px, stereo.is_stereo), ((640, 480), true));
        let stereo = without_head(&floats(&[400.0, 410.0, 310.0, 230.0, 0.1])).unwrap();
        assert_eq!((stereo.models[0].size((320, 240)).unwrap(), stereo.is_stereo), ((320, 240), true));
        assert_eq!(without_head(&[0; 50]), Err(NoCamera::Length(50)));
        assert_eq!(without_head(&[]), Err(NoCamera::Missing));
    }

    #[test]
    fn rectified_images_have_the_projection_and_raw_ones_the_matrix() {
        let projection = [400.0, 0.0, 310.0, 0.0, 0.0, 410.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let both = with_head(&mono_model(&[0.1, 0.2, 0.0, 0.0, 0.3], &projection)).unwrap();
        let rectified = pinhole(&both.models[0], Images::Rectified);
        assert_eq!((rectified.fx_px, rectified.cy_px, rectified.distortion.len()), (400.0, 230.0, 0));
        let raw = pinhole(&both.models[0], Images::Raw);
        assert_eq!((raw.fx_px, raw.cy_px, raw.distortion.len()), (500.0, 240.0, 5));
        // Without a projection there is the matrix alone, as RTAB-Map has it.
        let alone = with_head(&mono_model(&[], &[])).unwrap();
        assert_eq!(pinhole(&alone.models[0], Images::Rectified).fx_px, 500.0);
    }

    #[test]
    fn several_models_and_the_left_one_of_two_are_read() {
        let one = mono_model(&[], &[]);
        assert_eq!(with_head(&[one.clone(), one.clone()].concat()).unwrap().models.len(), 2);
        let head = [0, 20, 0, STEREO, 9, 3, 0, 0, one.len() as i32, one.len() as i32];
        let mut two: Vec<u8> = head.iter().flat_map(|value| value.to_le_bytes()).collect();
        two.extend([0; 12 * 8]);
        two.extend(one.iter().chain(&one));
        let stereo = with_head(&two).unwrap();
        assert_eq!((stereo.models.len(), stereo.is_stereo), (1, true));
        assert_eq!(pinhole(&stereo.models[0], Images::Rectified).fx_px, 500.0);
        assert!(matches!(with_head(&two[..two.len() - 1]), Err(NoCamera::Malformed(_))));
        two[12] = 7;
        assert_eq!(with_head(&two), Err(NoCamera::Kind(7)));
    }

    #[test]
    fn distortions_are_declared_or_refused() {
        let lens = |distortion: &[f64]| {
            with_head(&mono_model(distortion, &[])).unwrap().models[0].declared(Images::Raw, (640, 480))
        };
        let fisheye = lens(&[0.1, 0.2, 0.0, 0.0, 0.3, 0.4]).unwrap().lens;
        assert!(matches!(fisheye, Lens::Fisheye(found) if found.distortion == [0.1, 0.2, 0.3, 0.4]));
        assert_eq!(lens(&[0.1; 8]), Err(Undeclared::Rational { error_px: None }.into()));
        assert!(lens(&[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).is_ok());
        assert!(matches!(lens(&[0.1; 14]), Err(NoCamera::Undeclared(Undeclared::Model(_)))));
        assert!(lens(&[0.0; 14]).is_ok());
    }

    #[test]
    fn another_shape_of_image_is_refused() {
        let model = &with_head(&mono_model(&[], &[])).unwrap().models[0];
        assert_eq!(model.declared(Images::Raw, (320, 240)).unwrap().size_px, (640, 480));
        let other = NoCamera::Size { calibrated_px: (640, 480), image_px: (640, 360) };
        assert_eq!(model.declared(Images::Raw, (640, 360)), Err(other));
    }
}
