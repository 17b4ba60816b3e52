//! Images all around: from pixels to rays, features across the seam, and what two of them have in
//! common.
//!
//! Rays are of length 1, in axes x forward, y left, z up. A camera that looks into a mirror is
//! unwrapped first ([`mirror`]).

pub mod mirror;

use std::f64::consts::{PI, TAU};

use fabmap::descriptor::Descriptors;
use nalgebra::Vector3;
use topomap::evidence::TurnedView;
use waypost_navigation::appearance::epipolar::{self, PlanarMotion, RayPair, SearchSettings};
use waypost_navigation::appearance::graph::Overlap;

use crate::features::{Extractor, FeatureError, FeatureSettings, Features, Keypoint};
use crate::image::{GreyImage, ImageError};
use crate::matching::{self, Match};

/// How a panorama's columns and rows look out. Column c looks at the azimuth π - 2π (c + ½) /
/// width: the middle is ahead, left of it is left, and the edges meet behind. The horizon is in the
/// middle of the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Projection {
    /// On an upright cylinder: row r looks up by the slope 2π ((height - 1) / 2 - r) / width.
    Cylindrical,
    /// By elevation: row r looks up by the angle 2π ((height - 1) / 2 - r) / width.
    Equirectangular,
}

/// A projection with its size in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PanoramicCamera {
    projection: Projection,
    width_px: u32,
    height_px: u32,
}

/// Pixels that make no panorama.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PanoramaError {
    /// No pixels.
    #[error("a panorama of {width_px} x {height_px} pixels; both sides must be above 0")]
    Size {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// More rows than there is between nadir and zenith.
    #[error(
        "{height_px} rows of {width_px} columns reach beyond the poles; take at most half as many rows as columns"
    )]
    BeyondPoles {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
}

impl PanoramicCamera {
    /// # Errors
    /// [`PanoramaError`] if there are no pixels, or an equirectangular panorama would reach beyond
    /// the poles.
    pub fn new(projection: Projection, (width_px, height_px): (u32, u32)) -> Result<Self, PanoramaError> {
        if width_px == 0 || height_px == 0 {
            return Err(PanoramaError::Size { width_px, height_px });
        }
        match projection {
            Projection::Equirectangular if u64::from(height_px) * 2 > u64::from(width_px) => {
                Err(PanoramaError::BeyondPoles { width_px, height_px })
            }
            Projection::Cylindrical | Projection::Equirectangular => {
                Ok(Self { projection, width_px, height_px })
            }
        }
    }

    /// Columns and rows.
    #[must_use]
    pub fn size_px(&self) -> (u32, u32) {
        (self.width_px, self.height_px)
    }

    /// The ray of a column and row, which may lie between pixels or beyond the edges.
    #[must_use]
    pub fn ray(&self, [column, row]: [f64; 2]) -> Vector3<f64> {
        let rad_per_px = TAU / f64::from(self.width_px);
        let azimuth = PI - rad_per_px * (column + 0.5);
        let up = rad_per_px * ((f64::from(self.height_px) - 1.0) / 2.0 - row);
        let slope = match self.projection {
            Projection::Cylindrical => up,
            Projection::Equirectangular => up.tan(),
        };
        Vector3::new(azimuth.cos(), azimuth.sin(), slope).normalize()
    }

    /// Column, from -½ to width - ½, and row of a ray; `None` straight up or down.
    #[must_use]
    pub fn project(&self, ray: &Vector3<f64>) -> Option<[f64; 2]> {
        let across = ray.xy().norm();
        let px_per_rad = f64::from(self.width_px) / TAU;
        let up = match self.projection {
            Projection::Cylindrical => ray.z / across,
            Projection::Equirectangular => ray.z.atan2(across),
        };
        let column = (PI - ray.y.atan2(ray.x)) * px_per_rad - 0.5;
        (across > 0.0).then(|| [column, (f64::from(self.height_px) - 1.0) / 2.0 - px_per_rad * up])
    }
}

/// Share of the width by which a panorama is repeated beyond its edges for extraction: no feature
/// of use is larger.
const SEAM_WIDTHS: f64 = 1.0 / 16.0;

/// The strongest features of a panorama, those across its seam among them; none twice. As
/// [`Extractor::extract`] otherwise.
///
/// # Errors
/// [`FeatureError`].
pub fn extract(extractor: &Extractor, panorama: &GreyImage) -> Result<Features, FeatureError> {
    let settings = extractor.settings();
    let shrunk = panorama.resize_to_width(settings.image_width()).map_err(FeatureError::Shrink)?;
    let seam = (f64::from(shrunk.width()) * SEAM_WIDTHS).ceil() as u32;
    let padded = padded(&shrunk, seam).map_err(FeatureError::Shrink)?;
    let most = settings.max_features() as usize;
    // Some are found twice.
    let doubled = u32::try_from(most + most.div_ceil(4)).unwrap_or(u32::MAX);
    let width = padded.width().clamp(FeatureSettings::MIN_IMAGE_WIDTH, FeatureSettings::MAX_IMAGE_WIDTH);
    let beyond = FeatureSettings::new(settings.feature(), doubled.min(FeatureSettings::MAX_FEATURES), width);
    let found = Extractor::new(beyond.unwrap_or(settings)).extract(&padded)?;
    let factor = f64::from(panorama.width()) / f64::from(shrunk.width());
    let within = -0.5..f64::from(shrunk.width()) - 0.5;
    let kept = found.keypoints.iter().zip(found.descriptors.rows()).filter_map(|(keypoint, row)| {
        let column = f64::from(keypoint.x_px) - f64::from(seam);
        let scaled = |at: f64| ((at + 0.5) * factor - 0.5) as f32;
        within.contains(&column).then(|| {
            let x_px = scaled(column);
            let y_px = scaled(f64::from(keypoint.y_px));
            let size_px = (f64::from(keypoint.size_px) * factor) as f32;
            (Keypoint { x_px, y_px, size_px, ..*keypoint }, row)
        })
    });
    let (keypoints, rows): (Vec<Keypoint>, Vec<&[u8]>) = kept.take(most).unzip();
    let descriptors = Descriptors::new(found.descriptors.kind(), found.descriptors.width(), rows.concat())?;
    Ok(Features { keypoints, descriptors })
}

/// The panorama with `seam` columns more to either side, which are those of the other end.
fn padded(panorama: &GreyImage, seam: u32) -> Result<GreyImage, ImageError> {
    let width = panorama.width() as usize;
    let seam_px = seam as usize;
    let rows = panorama.pixels().chunks_exact(width);
    let pixels = rows.flat_map(|row| [&row[width - seam_px..], row, &row[..seam_px]].concat()).collect();
    GreyImage::new(panorama.width() + 2 * seam, panorama.height(), pixels)
}

/// The features of a panorama as rays, and how they look.
#[derive(Clone, Debug, PartialEq)]
pub struct PanoramicView {
    rays: Vec<Vector3<f64>>,
    descriptors: Descriptors,
}

/// What two panoramas have in common, with the matches behind it.
#[derive(Clone, Debug, PartialEq)]
pub struct PanoramicComparison {
    /// From the current view to the target; `None` if no motion joins them.
    pub overlap: Option<Overlap>,
    /// Features that look alike and like nothing else: `current` in the current view, `earlier` in
    /// the target.
    pub matches: Vec<Match>,
    /// Those of the matches, by index, that the motion explains.
    pub constrained: Vec<usize>,
}

impl PanoramicView {
    /// Features with their rays, by the camera whose pixels they are in.
    #[must_use]
    pub fn new(features: &Features, camera: &PanoramicCamera) -> Self {
        Self::of(&features.keypoints, features.descriptors.clone(), camera)
    }

    /// The same from keypoints and their descriptors, one row each.
    #[must_use]
    pub fn of(keypoints: &[Keypoint], descriptors: Descriptors, camera: &PanoramicCamera) -> Self {
        let ray = |keypoint: &Keypoint| camera.ray([keypoint.x_px, keypoint.y_px].map(f64::from));
        Self { rays: keypoints.iter().map(ray).collect(), descriptors }
    }

    /// Where the features lie: unit rays.
    #[must_use]
    pub fn rays(&self) -> &[Vector3<f64>] {
        &self.rays
    }

    /// How they look.
    #[must_use]
    pub fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    /// The features that are each other's nearest by far, in this view and the target.
    #[must_use]
    pub fn matches(&self, target: &PanoramicView) -> Vec<Match> {
        let mut matches = matching::descriptor_matches(&target.descriptors, &self.descriptors);
        matches.retain(|matched| matched.distinct);
        matches
    }

    /// What this view and that of the target have in common, by planar motion.
    #[must_use]
    pub fn compare(&self, target: &PanoramicView, search: &SearchSettings) -> PanoramicComparison {
        let matches = self.matches(target);
        let pairs = self.ray_pairs(target, &matches);
        let found = epipolar::search::<PlanarMotion>(&pairs, search);
        let features = self.rays.len().min(target.rays.len());
        let (overlap, constrained) = found.map_or((None, Vec::new()), |found| {
            let constrained = found.inliers.len() as u32;
            let overlap = Overlap { constrained, features: features as u32, motion: found.motion };
            (Some(overlap), found.inliers)
        });
        PanoramicComparison { overlap, matches, constrained }
    }

    /// What this view and that of the target have in common if the camera has at most turned on the
    /// spot, each ray to `tolerance_rad`.
    #[must_use]
    pub fn turned(&self, target: &PanoramicView, tolerance_rad: f64) -> TurnedView {
        let pairs = self.ray_pairs(target, &self.matches(target));
        let turn = epipolar::turn(&pairs, tolerance_rad);
        TurnedView {
            features: self.rays.len().min(target.rays.len()) as u32,
            matches: pairs.len() as u32,
            turned: turn.map_or(0, |turn| turn.agreeing as u32),
        }
    }

    /// The rays of matches.
    #[must_use]
    pub fn ray_pairs(&self, target: &PanoramicView, matches: &[Match]) -> Vec<RayPair> {
        let pair = |matched: &Match| RayPair {
            current: self.rays[matched.current],
            target: target.rays[matched.earlier],
        };
        matches.iter().map(pair).collect()
    }
}

#[cfg(test)]
mod tests;
