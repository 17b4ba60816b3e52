//! Local features: where they are in the image and how they look.

mod settings;

use std::collections::HashSet;

use fabmap::descriptor::Descriptors;
use opencv::core::{KeyPoint, KeyPointTrait, KeyPointTraitConst, Mat, Vector, no_array};
use opencv::features2d::{
    AKAZE, AKAZE_DescriptorType, Feature2DTrait, KAZE_DiffusivityType, ORB, ORB_ScoreType, SIFT,
};

use crate::image::{self, GreyImage, ImageError, MIN_SIDE_PX};
use crate::mat;

pub use settings::{Feature, FeatureSettings, SettingsError};

/// How tall an image may be that features are looked for in, in widths of the settings: more than
/// any camera delivers. Time and memory go with the area, and the width alone does not bound it.
pub const MAX_HEIGHT_WIDTHS: u32 = 4;

/// Finds and describes the local features of images.
///
/// Holds its settings alone and is shared freely between threads: an OpenCV detector keeps working
/// memory of its own and must not serve two calls at once, but making one takes far less than a
/// microsecond beside the milliseconds that it runs for, so every call makes its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extractor {
    settings: FeatureSettings,
}

impl Extractor {
    /// An extractor that works by `settings`.
    #[must_use]
    pub fn new(settings: FeatureSettings) -> Self {
        Self { settings }
    }

    /// The settings it works by.
    #[must_use]
    pub fn settings(&self) -> FeatureSettings {
        self.settings
    }

    /// The strongest features of `image`, strongest first.
    ///
    /// The image is shrunk to the settings' width before; a narrower one is taken at its own size.
    /// One that would still be taller than [`MAX_HEIGHT_WIDTHS`] such widths is shrunk further, to
    /// that height. The order, and so the result, depends on the image and the settings alone:
    /// equal responses are ordered by position, then size and angle. An image without structure has
    /// no features, which is no error.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn extract(&self, image: &GreyImage) -> Result<Features, FeatureError> {
        let shrunk = image.resize_to_width(self.width_to_look_in(image)).map_err(FeatureError::Shrink)?;
        if shrunk.width().min(shrunk.height()) < MIN_SIDE_PX {
            return Err(FeatureError::TooSmall { width: shrunk.width(), height: shrunk.height() });
        }
        let mut described = self.detect_and_describe(&shrunk)?;
        described.sort_by(|(a, _), (b, _)| {
            b.response
                .total_cmp(&a.response)
                .then(a.y_px.total_cmp(&b.y_px))
                .then(a.x_px.total_cmp(&b.x_px))
                .then(a.size_px.total_cmp(&b.size_px))
                .then(a.angle_rad.total_cmp(&b.angle_rad))
        });
        described.truncate(usize::try_from(self.settings.max_features()).unwrap_or(usize::MAX));

        let scale = Scale::between(&shrunk, image);
        let (keypoints, rows): (Vec<_>, Vec<_>) =
            described.into_iter().map(|(keypoint, row)| (scale.apply(keypoint), row)).unzip();
        let feature = self.settings.feature();
        let descriptors =
            Descriptors::new(feature.descriptor_kind(), feature.descriptor_width(), rows.concat())?;
        Ok(Features { keypoints, descriptors })
    }

    /// The width that an image is shrunk to, if it is wider: the settings', less for a very tall
    /// one.
    fn width_to_look_in(&self, image: &GreyImage) -> u32 {
        let width = self.settings.image_width();
        let tallest = u64::from(MAX_HEIGHT_WIDTHS * width);
        let width_at_tallest = u64::from(image.width()) * tallest / u64::from(image.height());
        u32::try_from(width_at_tallest).map_or(width, |narrow| narrow.clamp(1, width))
    }

    /// Decodes a JPEG or PNG and extracts its features; the image comes back with them.
    ///
    /// # Errors
    /// [`ExtractError`].
    pub fn extract_encoded(&self, bytes: &[u8]) -> Result<(GreyImage, Features), ExtractError> {
        let image = image::decode(bytes)?;
        let features = self.extract(&image)?;
        Ok((image, features))
    }

    /// Keypoints in pixels of `image`, each with its descriptor, in OpenCV's order.
    fn detect_and_describe(&self, image: &GreyImage) -> Result<Vec<(Keypoint, Vec<u8>)>, FeatureError> {
        mat::use_one_thread_per_call()?;
        let pixels = mat::borrow_grey(image.width(), image.height(), image.pixels())?;
        let mut found = Vector::<KeyPoint>::new();
        let mut matrix = Mat::default();
        let most = i32::try_from(self.settings.max_features()).unwrap_or(i32::MAX);
        match self.settings.feature() {
            Feature::Sift | Feature::RootSift => {
                sift(most)?.detect_and_compute_def(&pixels, &no_array(), &mut found, &mut matrix)?;
            }
            Feature::UprightRootSift => {
                let mut sift = sift(UNLIMITED)?;
                sift.detect_def(&pixels, &mut found)?;
                found = upright(&found, most);
                sift.compute(&pixels, &mut found, &mut matrix)?;
            }
            Feature::Orb => {
                orb(most)?.detect_and_compute_def(&pixels, &no_array(), &mut found, &mut matrix)?;
            }
            Feature::Akaze => {
                akaze()?.detect_and_compute_def(&pixels, &no_array(), &mut found, &mut matrix)?;
            }
        }
        let rows: Vec<Vec<u8>> = match self.settings.feature() {
            Feature::Sift => mat::float_rows(&matrix)?.into_iter().map(sift_bytes).collect(),
            Feature::RootSift | Feature::UprightRootSift => {
                mat::float_rows(&matrix)?.into_iter().map(root_sift_bytes).collect()
            }
            Feature::Orb | Feature::Akaze => {
                mat::byte_rows(&matrix)?.into_iter().map(<[u8]>::to_vec).collect()
            }
        };
        let offset_px = self.settings.feature().opencv_offset_px();
        let keypoints = found.iter().map(|keypoint| Keypoint::from_opencv(&keypoint, offset_px));
        Ok(keypoints.zip(rows).collect())
    }
}

/// The features of one image: keypoint `i` is described by descriptor row `i`.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    /// Where the features are, strongest first.
    pub keypoints: Vec<Keypoint>,
    /// How they look: one row per keypoint, of the feature's kind and width even if there is none.
    pub descriptors: Descriptors,
}

/// Where a feature is, in pixels of the image as it was given (not of the shrunk one).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// To the right, in pixels; 0 is the centre of the leftmost column.
    pub x_px: f32,
    /// Down, in pixels; 0 is the centre of the top row.
    pub y_px: f32,
    /// Diameter of the neighbourhood that means something, in pixels.
    pub size_px: f32,
    /// Orientation in the image, in radians within 0 to 2π, from x to the right towards y down.
    pub angle_rad: f32,
    /// Strength of the detector's answer; comparable within one feature only.
    pub response: f32,
}

impl Features {
    /// Those whose keypoints are wanted.
    #[must_use]
    pub fn filtered(self, is_wanted: impl Fn(&Keypoint) -> bool) -> Self {
        let Self { keypoints, descriptors } = self;
        let wanted = keypoints.iter().zip(descriptors.rows()).filter(|(keypoint, _)| is_wanted(keypoint));
        let (kept, rows): (Vec<Keypoint>, Vec<&[u8]>) =
            wanted.map(|(keypoint, row)| (*keypoint, row)).unzip();
        // Rows of descriptors are rows of descriptors.
        match Descriptors::new(descriptors.kind(), descriptors.width(), rows.concat()) {
            Ok(descriptors) => Self { keypoints: kept, descriptors },
            Err(_) => Self { keypoints, descriptors },
        }
    }
}

impl Keypoint {
    fn from_opencv(keypoint: &KeyPoint, offset_px: f32) -> Self {
        Self {
            x_px: keypoint.pt().x - offset_px,
            y_px: keypoint.pt().y - offset_px,
            size_px: keypoint.size(),
            angle_rad: keypoint.angle().to_radians(),
            response: keypoint.response(),
        }
    }
}

/// Why no features could be extracted from an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FeatureError {
    /// Too few pixels are left after shrinking.
    #[error(
        "features are looked for in an image of {width} x {height}, but both sides must have at least {min} pixels; \
         send a larger image, one that is less long and narrow, or use a model with a larger image width",
        min = MIN_SIDE_PX
    )]
    TooSmall {
        /// Pixels per row after shrinking.
        width: u32,
        /// Rows after shrinking.
        height: u32,
    },
    /// The image could not be shrunk.
    #[error(transparent)]
    Shrink(ImageError),
    /// OpenCV failed.
    #[error("feature extraction failed ({reason}); try again when the machine has memory to spare")]
    OpenCv {
        /// OpenCV's words.
        reason: String,
    },
    /// OpenCV returned descriptors of another width than the feature has.
    #[error("OpenCV's descriptors are not the expected ones ({0}); use OpenCV 4.6")]
    Descriptors(#[from] fabmap::descriptor::DescriptorError),
}

impl From<opencv::Error> for FeatureError {
    fn from(error: opencv::Error) -> Self {
        FeatureError::OpenCv { reason: error.message }
    }
}

/// Why an encoded image gave no features.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExtractError {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The image was read, but no features could be extracted.
    #[error(transparent)]
    Feature(#[from] FeatureError),
}

/// From the pixels of a shrunk image to those of the image it was made from.
struct Scale {
    x: f64,
    y: f64,
}

impl Scale {
    fn between(shrunk: &GreyImage, given: &GreyImage) -> Self {
        Self {
            x: f64::from(given.width()) / f64::from(shrunk.width()),
            y: f64::from(given.height()) / f64::from(shrunk.height()),
        }
    }

    fn apply(&self, keypoint: Keypoint) -> Keypoint {
        // Images are scaled about their corner, half a pixel away from the centre of pixel 0.
        let from_corner = |position: f32, scale: f64| ((f64::from(position) + 0.5) * scale - 0.5) as f32;
        Keypoint {
            x_px: from_corner(keypoint.x_px, self.x),
            y_px: from_corner(keypoint.y_px, self.y),
            size_px: (f64::from(keypoint.size_px) * self.x) as f32,
            ..keypoint
        }
    }
}

/// As many features as there are, in OpenCV's terms.
const UNLIMITED: i32 = 0;

/// The strongest keypoints, each once whatever its orientations, and as the camera stands.
fn upright(found: &Vector<KeyPoint>, most: i32) -> Vector<KeyPoint> {
    let mut seen = HashSet::new();
    let place = |keypoint: &KeyPoint| [keypoint.pt().x, keypoint.pt().y, keypoint.size()].map(f32::to_bits);
    let mut once: Vec<KeyPoint> = found.iter().filter(|keypoint| seen.insert(place(keypoint))).collect();
    once.sort_by(|a, b| {
        b.response()
            .total_cmp(&a.response())
            .then(a.pt().y.total_cmp(&b.pt().y))
            .then(a.pt().x.total_cmp(&b.pt().x))
            .then(a.size().total_cmp(&b.size()))
    });
    once.truncate(usize::try_from(most).unwrap_or(usize::MAX));
    once.iter_mut().for_each(|keypoint| keypoint.set_angle(0.0));
    once.into()
}

/// OpenCV's SIFT descriptor, which is integers from 0 to 255 already, though in floats.
fn sift_bytes(row: &[f32]) -> Vec<u8> {
    row.iter().map(|&value| round_to_byte(f64::from(value))).collect()
}

/// √(d / ‖d‖₁) · scale, Arandjelović & Zisserman 2012, section 2.
fn root_sift_bytes(row: &[f32]) -> Vec<u8> {
    let sum: f64 = row.iter().map(|&value| f64::from(value)).sum();
    let norm = if sum > 0.0 { sum } else { 1.0 };
    row.iter()
        .map(|&value| round_to_byte((f64::from(value) / norm).sqrt() * Feature::ROOT_SIFT_SCALE))
        .collect()
}

/// Rounds and clamps to 0..=255.
fn round_to_byte(value: f64) -> u8 {
    // A float cast saturates, and turns NaN into 0.
    value.round() as u8
}

// OpenCV's own defaults throughout, written out: they are part of what a model's words mean.

fn sift(most: i32) -> opencv::Result<opencv::core::Ptr<SIFT>> {
    let octave_layers = 3;
    let contrast_threshold = 0.04;
    let edge_threshold = 10.0;
    let sigma = 1.6;
    SIFT::create(most, octave_layers, contrast_threshold, edge_threshold, sigma)
}

fn orb(most: i32) -> opencv::Result<opencv::core::Ptr<ORB>> {
    let scale_factor = 1.2;
    let levels = 8;
    let first_level = 0;
    let border_px = 31;
    let patch_px = 31;
    let points_compared = 2;
    let fast_threshold = 20;
    ORB::create(
        most,
        scale_factor,
        levels,
        border_px,
        first_level,
        points_compared,
        ORB_ScoreType::HARRIS_SCORE,
        patch_px,
        fast_threshold,
    )
}

fn akaze() -> opencv::Result<opencv::core::Ptr<AKAZE>> {
    let whole_descriptor = 0;
    let channels = 3;
    let threshold = 0.001;
    let octaves = 4;
    let octave_layers = 4;
    AKAZE::create(
        AKAZE_DescriptorType::DESCRIPTOR_MLDB,
        whole_descriptor,
        channels,
        threshold,
        octaves,
        octave_layers,
        KAZE_DiffusivityType::DIFF_PM_G2,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn root_sift_is_the_square_root_of_the_l1_normalised_descriptor() {
        let mut row = [0.0; 128];
        row[..4].fill(16.0);
        row[4..20].fill(4.0);
        let bytes = root_sift_bytes(&row);
        // 16 / 128 and 4 / 128 of the sum.
        assert_eq!(bytes[0], (512.0 * 0.125f64.sqrt()).round() as u8);
        assert_eq!(bytes[4], (512.0 * 0.03125f64.sqrt()).round() as u8);
        assert_eq!(bytes[20], 0);
        assert_eq!(root_sift_bytes(&[0.0; 128]), vec![0; 128]);
    }

    #[test]
    fn bytes_are_rounded_and_clamped() {
        assert_eq!([-1.0, 0.4, 0.5, 254.6, 300.0].map(round_to_byte), [0, 0, 1, 255, 255]);
    }
}
