//! From pixels to rays, for cameras that are level.

use std::f64::consts::{PI, TAU};

use nalgebra::{Vector2, Vector3};

/// A camera without lens distortion that is held level. So each of its columns looks along one
/// vertical plane, and each of its rows along one slope: all projections share one renderer.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    projection: Projection,
    width_px: u32,
    height_px: u32,
}

/// How space is projected onto the image.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Projection {
    Perspective { focal_px: [f64; 2], center_px: [f64; 2] },
    Cylindrical,
    Equirectangular,
}

/// How a camera sees that looks all around.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Panorama {
    /// On an upright cylinder; see [`Camera::cylindrical`].
    Cylindrical,
    /// By azimuth and elevation; see [`Camera::equirectangular`].
    Equirectangular,
}

/// Numbers that make no camera.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// No pixels, or too many.
    #[error(
        "an image of {width_px} x {height_px} pixels; both sides must be from 2 to {}",
        Camera::MAX_SIDE_PX
    )]
    Size {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// A focal length that is not positive, or a centre that is not a number.
    #[error("focal lengths {focal_px:?} and centre {center_px:?}: the first must be positive, all finite")]
    Intrinsics {
        /// In x and y.
        focal_px: [f64; 2],
        /// Column and row.
        center_px: [f64; 2],
    },
    /// No perspective image shows so much.
    #[error(
        "a field of view of {horizontal_rad} rad; it must be above 0 and below π: take a panorama for more"
    )]
    FieldOfView {
        /// From the left to the right edge.
        horizontal_rad: f64,
    },
    /// An equirectangular panorama that would reach beyond the poles.
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

/// What a column sees: the points position + t (direction, slope), t > 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ColumnRay {
    /// In the plane of the floor, in the camera's frame (x forward, y left).
    pub(crate) direction: Vector2<f64>,
    /// By how much the direction changes to the next column.
    pub(crate) step: Vector2<f64>,
}

/// What a row sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RowSlope {
    /// Rise per t.
    pub(crate) slope: f32,
    /// By how much the slope changes to the next row.
    pub(crate) step: f32,
}

impl Camera {
    /// Most columns or rows.
    pub const MAX_SIDE_PX: u32 = 8192;

    /// A pinhole camera, in pixels: focal lengths in x and y, and the column and row where its axis
    /// meets the image, counted from the centre of the top left pixel.
    ///
    /// # Errors
    /// [`CameraError`] if the numbers make no camera.
    pub fn perspective(
        focal_px: [f64; 2],
        center_px: [f64; 2],
        (width_px, height_px): (u32, u32),
    ) -> Result<Self, CameraError> {
        let finite = focal_px.iter().chain(&center_px).all(|number| number.is_finite());
        if !finite || focal_px.iter().any(|&focal| focal <= 0.0) {
            return Err(CameraError::Intrinsics { focal_px, center_px });
        }
        Self::of(Projection::Perspective { focal_px, center_px }, width_px, height_px)
    }

    /// A pinhole camera with square pixels that looks through the middle of its image and sees
    /// `horizontal_rad` from the left to the right edge.
    ///
    /// # Errors
    /// [`CameraError`] if the numbers make no camera.
    pub fn of_field_of_view(
        horizontal_rad: f64,
        (width_px, height_px): (u32, u32),
    ) -> Result<Self, CameraError> {
        if !(horizontal_rad > 0.0 && horizontal_rad < PI) {
            return Err(CameraError::FieldOfView { horizontal_rad });
        }
        let focal_px = f64::from(width_px) / 2.0 / (horizontal_rad / 2.0).tan();
        let center_px = [width_px, height_px].map(|side| (f64::from(side) - 1.0) / 2.0);
        Self::perspective([focal_px; 2], center_px, (width_px, height_px))
    }

    /// A panorama on an upright cylinder. Column c looks at the azimuth π - 2π (c + ½) / width: the
    /// middle is ahead, left of it is left, and the edges meet behind. Rows have the columns' scale
    /// at the horizon, which is in the middle: row r looks up by the slope 2π ((height - 1) / 2 -
    /// r) / width.
    ///
    /// # Errors
    /// [`CameraError::Size`] if there are no pixels, or too many.
    pub fn cylindrical((width_px, height_px): (u32, u32)) -> Result<Self, CameraError> {
        Self::of(Projection::Cylindrical, width_px, height_px)
    }

    /// A panorama by azimuth and elevation. Columns as in [`Camera::cylindrical`]; row r looks up
    /// by the angle 2π ((height - 1) / 2 - r) / width.
    ///
    /// # Errors
    /// [`CameraError`] if there are no pixels, or too many, or if it would reach beyond the poles.
    pub fn equirectangular((width_px, height_px): (u32, u32)) -> Result<Self, CameraError> {
        if 2 * u64::from(height_px) > u64::from(width_px) {
            return Err(CameraError::BeyondPoles { width_px, height_px });
        }
        Self::of(Projection::Equirectangular, width_px, height_px)
    }

    fn of(projection: Projection, width_px: u32, height_px: u32) -> Result<Self, CameraError> {
        let sides = 2..=Self::MAX_SIDE_PX;
        if !sides.contains(&width_px) || !sides.contains(&height_px) {
            return Err(CameraError::Size { width_px, height_px });
        }
        Ok(Self { projection, width_px, height_px })
    }

    /// Focal lengths in x and y and the centre, in pixels; `None` of a panorama.
    #[must_use]
    pub fn intrinsics_px(&self) -> Option<[[f64; 2]; 2]> {
        match self.projection {
            Projection::Perspective { focal_px, center_px } => Some([focal_px, center_px]),
            Projection::Cylindrical | Projection::Equirectangular => None,
        }
    }

    /// How it looks all around; `None` of one that looks ahead.
    #[must_use]
    pub fn panorama(&self) -> Option<Panorama> {
        match self.projection {
            Projection::Perspective { .. } => None,
            Projection::Cylindrical => Some(Panorama::Cylindrical),
            Projection::Equirectangular => Some(Panorama::Equirectangular),
        }
    }

    /// What it sees from the left to the right edge, in radians.
    #[must_use]
    pub fn field_of_view_rad(&self) -> f64 {
        match self.projection {
            Projection::Perspective { focal_px: [focal_px, _], .. } => {
                2.0 * (f64::from(self.width_px) / 2.0 / focal_px).atan()
            }
            Projection::Cylindrical | Projection::Equirectangular => TAU,
        }
    }

    /// Columns.
    #[must_use]
    pub fn width_px(&self) -> u32 {
        self.width_px
    }

    /// Rows.
    #[must_use]
    pub fn height_px(&self) -> u32 {
        self.height_px
    }

    /// Column and row where a point is projected, given in the camera's frame (x forward, y left, z
    /// up), in metres. `None` if it lies behind a perspective camera, or in the axis of a panorama;
    /// it may lie outside of the image.
    #[must_use]
    pub fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        let horizontal_m = point.xy().norm();
        let pixels_per_rad = f64::from(self.width_px) / TAU;
        let middle_row = (f64::from(self.height_px) - 1.0) / 2.0;
        let column = (PI - point.y.atan2(point.x)) * pixels_per_rad - 0.5;
        match self.projection {
            Projection::Perspective { focal_px, center_px } => (point.x > 0.0)
                .then(|| [0, 1].map(|axis| center_px[axis] - focal_px[axis] * point[axis + 1] / point.x)),
            Projection::Cylindrical => {
                (horizontal_m > 0.0).then(|| [column, middle_row - pixels_per_rad * point.z / horizontal_m])
            }
            Projection::Equirectangular => (horizontal_m > 0.0)
                .then(|| [column, middle_row - pixels_per_rad * point.z.atan2(horizontal_m)]),
        }
    }

    pub(crate) fn column_ray(&self, column: u32) -> ColumnRay {
        match self.projection {
            Projection::Perspective { focal_px: [focal, _], center_px: [center, _] } => ColumnRay {
                direction: Vector2::new(1.0, (center - f64::from(column)) / focal),
                step: Vector2::new(0.0, -1.0 / focal),
            },
            Projection::Cylindrical | Projection::Equirectangular => {
                let rad_per_pixel = TAU / f64::from(self.width_px);
                let azimuth = PI - rad_per_pixel * (f64::from(column) + 0.5);
                let direction = Vector2::new(azimuth.cos(), azimuth.sin());
                ColumnRay { direction, step: rad_per_pixel * Vector2::new(direction.y, -direction.x) }
            }
        }
    }

    pub(crate) fn row_slopes(&self) -> Vec<RowSlope> {
        let rad_per_pixel = TAU / f64::from(self.width_px);
        let above_middle = |row: u32| (f64::from(self.height_px) - 1.0) / 2.0 - f64::from(row);
        let slope = |row: u32| match self.projection {
            Projection::Perspective { focal_px: [_, focal], center_px: [_, center] } => {
                ((center - f64::from(row)) / focal, 1.0 / focal)
            }
            Projection::Cylindrical => (rad_per_pixel * above_middle(row), rad_per_pixel),
            Projection::Equirectangular => {
                let slope = (rad_per_pixel * above_middle(row)).tan();
                (slope, rad_per_pixel * (1.0 + slope * slope))
            }
        };
        let row_slope = |(slope, step)| RowSlope { slope: slope as f32, step: step as f32 };
        (0..self.height_px).map(|row| row_slope(slope(row))).collect()
    }

    /// Pixels by which the image shifts when the camera turns by one radian, in its middle.
    pub(crate) fn pixels_per_rad(&self) -> f64 {
        match self.projection {
            Projection::Perspective { focal_px: [focal, _], .. } => focal,
            Projection::Cylindrical | Projection::Equirectangular => f64::from(self.width_px) / TAU,
        }
    }
}
