//! A camera that looks up into a hyperbolic mirror: one image shows all around, wound about a
//! centre.
//!
//! The camera's pinhole lies in one focus of the hyperbola; what is reflected to it went towards
//! the other, so all rays meet there (Baker & Nayar, IJCV 35(2) 1999). A ray that rises by the
//! angle φ comes to the radius ρ = f cos φ / (ξ - sin φ) from the centre (Geyer & Daniilidis, ECCV
//! 2000), straight down to the centre itself.

use std::f64::consts::{PI, TAU};

use super::{PanoramicCamera, Projection};
use crate::image::{GreyImage, ImageError};

/// A camera with a hyperbolic mirror above it, in pixels of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HyperbolicMirror {
    center_px: [f64; 2],
    inner_radius_px: f64,
    outer_radius_px: f64,
    focal_px: f64,
    parameter: f64,
    ahead_rad: f64,
}

/// The shape of a mirror.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MirrorSettings {
    /// Column and row of the mirror's axis.
    pub center_px: [f64; 2],
    /// Radii between which the world is seen: further in is the camera itself, further out is past
    /// the mirror.
    pub radii_px: [f64; 2],
    /// Radius at which the horizon is seen.
    pub horizon_radius_px: f64,
    /// ξ = 2e / (1 + e²) of a mirror of eccentricity e > 1, in (0, 1); towards 1 it becomes a
    /// parabola's.
    pub parameter: f64,
    /// Where ahead lies in the image, in radians from its right counter-clockwise as one looks at
    /// it.
    pub ahead_rad: f64,
}

/// Numbers that make no mirror.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MirrorError {
    /// Not a ring.
    #[error(
        "radii {radii_px:?} about {center_px:?} are no ring; the first must be above 0 and below the second"
    )]
    Radii {
        /// Centre.
        center_px: [f64; 2],
        /// Inner and outer.
        radii_px: [f64; 2],
    },
    /// A horizon without a radius.
    #[error("a horizon at a radius of {horizon_radius_px} pixels; it must be above 0")]
    Horizon {
        /// As given.
        horizon_radius_px: f64,
    },
    /// No hyperbola.
    #[error("a mirror parameter of {parameter}; it must be above 0 and below 1")]
    Parameter {
        /// As given.
        parameter: f64,
    },
    /// Ahead is nowhere.
    #[error("ahead lies at {ahead_rad} rad, which is no number")]
    Ahead {
        /// As given.
        ahead_rad: f64,
    },
}

impl HyperbolicMirror {
    /// # Errors
    /// [`MirrorError`] if the numbers make no mirror.
    pub fn new(settings: MirrorSettings) -> Result<Self, MirrorError> {
        let MirrorSettings { center_px, radii_px, horizon_radius_px, parameter, ahead_rad } = settings;
        let [inner_radius_px, outer_radius_px] = radii_px;
        let finite = center_px.iter().chain(&radii_px).all(|value| value.is_finite());
        if !(finite && inner_radius_px > 0.0 && inner_radius_px < outer_radius_px) {
            return Err(MirrorError::Radii { center_px, radii_px });
        }
        if !(horizon_radius_px.is_finite() && horizon_radius_px > 0.0) {
            return Err(MirrorError::Horizon { horizon_radius_px });
        }
        if !(parameter > 0.0 && parameter < 1.0) {
            return Err(MirrorError::Parameter { parameter });
        }
        if !ahead_rad.is_finite() {
            return Err(MirrorError::Ahead { ahead_rad });
        }
        // At the horizon ρ = f / ξ.
        let focal_px = horizon_radius_px * parameter;
        Ok(Self { center_px, inner_radius_px, outer_radius_px, focal_px, parameter, ahead_rad })
    }

    /// Radius at which a ray is seen that rises by `elevation_rad`: ρ = f cos / (ξ - sin). `None`
    /// where the mirror has no image of it.
    #[must_use]
    pub fn radius_px(&self, elevation_rad: f64) -> Option<f64> {
        let (sine, cosine) = elevation_rad.sin_cos();
        let depth = self.parameter - sine;
        (depth > 0.0).then(|| self.focal_px * cosine / depth)
    }

    /// How much a ray rises that is seen at a radius: [`HyperbolicMirror::radius_px`] the other way
    /// round.
    #[must_use]
    pub fn elevation_rad(&self, radius_px: f64) -> f64 {
        // f cos φ + ρ sin φ = ρ ξ.
        let length = self.focal_px.hypot(radius_px);
        radius_px.atan2(self.focal_px) - (radius_px * self.parameter / length).acos()
    }

    /// Columns and rows of a panorama `width_px` wide that shows all that the ring does, but no
    /// slope above π / 2 up or down: the panorama has at most half as many rows as columns.
    #[must_use]
    pub fn panorama_size_px(&self, width_px: u32) -> (u32, u32) {
        let slopes = self.radii_px().map(|radius| self.elevation_rad(radius).tan().abs());
        let half = f64::from(width_px) / TAU * slopes[0].max(slopes[1]);
        let most = (width_px / 4).max(1);
        (width_px, 2 * (half.ceil() as u32).clamp(1, most))
    }

    /// Whether the rows of a panorama of `size_px` within `margin_px` of a row show the ring, and
    /// nothing beyond its edges.
    #[must_use]
    pub fn shows_row(&self, size_px: (u32, u32), row: f64, margin_px: f64) -> bool {
        let (width, height) = (f64::from(size_px.0), f64::from(size_px.1));
        let [lowest, highest] = self.radii_px().map(|radius| self.elevation_rad(radius).tan());
        let slope = |row: f64| TAU / width * ((height - 1.0) / 2.0 - row);
        slope(row + margin_px) >= lowest && slope(row - margin_px) <= highest
    }

    fn radii_px(&self) -> [f64; 2] {
        [self.inner_radius_px, self.outer_radius_px]
    }

    /// Column and row of a direction, counter-clockwise from ahead and up from the horizon; `None`
    /// outside of the ring.
    #[must_use]
    pub fn project(&self, azimuth_rad: f64, elevation_rad: f64) -> Option<[f64; 2]> {
        let radius = self.radius_px(elevation_rad)?;
        let angle = self.ahead_rad + azimuth_rad;
        let [x, y] = self.center_px;
        // Rows go down.
        (self.inner_radius_px..=self.outer_radius_px)
            .contains(&radius)
            .then(|| [x + radius * angle.cos(), y - radius * angle.sin()])
    }

    /// The cylindrical panorama of `size_px`: its rows as [`Projection::Cylindrical`] says. What
    /// the mirror does not show is black.
    ///
    /// # Errors
    /// [`ImageError`] if there would be no pixels, or too many.
    pub fn unwrapped(&self, image: &GreyImage, size_px: (u32, u32)) -> Result<GreyImage, ImageError> {
        let (width, height) = size_px;
        let rad_per_px = TAU / f64::from(width.max(1));
        let mut pixels = Vec::with_capacity(width as usize * height as usize);
        for row in 0..height {
            let elevation = (rad_per_px * ((f64::from(height) - 1.0) / 2.0 - f64::from(row))).atan();
            for column in 0..width {
                let azimuth = PI - rad_per_px * (f64::from(column) + 0.5);
                let grey = self.project(azimuth, elevation).map_or(0.0, |at| interpolated(image, at));
                pixels.push(grey.round() as u8);
            }
        }
        GreyImage::new(width, height, pixels)
    }

    /// The camera that the unwrapped panorama is of.
    ///
    /// # Errors
    /// [`super::PanoramaError`] if there are no pixels.
    pub fn unwrapped_camera(size_px: (u32, u32)) -> Result<PanoramicCamera, super::PanoramaError> {
        PanoramicCamera::new(Projection::Cylindrical, size_px)
    }
}

/// Between the four pixels around a point; black outside of the image.
fn interpolated(image: &GreyImage, [x, y]: [f64; 2]) -> f64 {
    let (left, top) = (x.floor(), y.floor());
    let at = |column: f64, row: f64| {
        let inside = column >= 0.0
            && row >= 0.0
            && column < f64::from(image.width())
            && row < f64::from(image.height());
        let index = || row as usize * image.width() as usize + column as usize;
        if inside { f64::from(image.pixels()[index()]) } else { 0.0 }
    };
    let (right_share, lower_share) = (x - left, y - top);
    let along = |row: f64| at(left, row) * (1.0 - right_share) + at(left + 1.0, row) * right_share;
    along(top) * (1.0 - lower_share) + along(top + 1.0) * lower_share
}
