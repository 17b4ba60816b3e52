//! Cameras of panoramas, described by their images or by a file.

use std::f64::consts::PI;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use serde::Deserialize;
use waypost_client::v1;
use waypost_sim::camera::Panorama;

use crate::failure::Failure;
use crate::images::ImageFile;
use crate::shrinking::{MOST_PIXELS, upright_size_px};

/// The projection of a panorama. It covers 360 degrees, its pixels are square, and the horizon is
/// in the middle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Projection {
    /// On an upright cylinder
    Cylindrical,
    /// By elevation
    Equirectangular,
}

impl From<Projection> for Panorama {
    fn from(projection: Projection) -> Self {
        match projection {
            Projection::Cylindrical => Self::Cylindrical,
            Projection::Equirectangular => Self::Equirectangular,
        }
    }
}

impl From<Panorama> for Projection {
    fn from(panorama: Panorama) -> Self {
        match panorama {
            Panorama::Cylindrical => Self::Cylindrical,
            Panorama::Equirectangular => Self::Equirectangular,
        }
    }
}

/// The JSON description of a camera that looks up into a hyperbolic mirror, as in
/// `waypost.v1.HyperbolicMirror`.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Mirror {
    center_x_px: f64,
    center_y_px: f64,
    inner_radius_px: f64,
    outer_radius_px: f64,
    eccentricity: f64,
    horizon_radius_px: f64,
    #[serde(default)]
    ahead_rad: f64,
}

/// The camera of images of a size that a file of JSON describes.
pub(crate) fn mirror_camera(file: &Path, size_px: (u32, u32)) -> Result<v1::Camera, Failure> {
    let name = file.display();
    let (width_px, height_px) = size_px;
    if u64::from(width_px) * u64::from(height_px) > MOST_PIXELS {
        return Err(Failure::Unfit(format!(
            "images of {width_px} x {height_px} pixels are larger than the {} megapixels that a server takes, and made smaller \
             they would not be those that {name} describes: make them smaller, and its numbers with them",
            MOST_PIXELS / 1_000_000
        )));
    }
    let text = std::fs::read_to_string(file).map_err(|error| {
        Failure::Unfit(format!("{name} cannot be read: {error}; check the path and its permissions"))
    })?;
    let mirror = serde_json::from_str(&text).map_err(|error| {
        Failure::Unfit(format!(
            "{name} describes no mirror: {error}; write a JSON object with the numbers center_x_px, center_y_px, \
             inner_radius_px, outer_radius_px, eccentricity and horizon_radius_px, and with ahead_rad if the robot's front \
             is not to the right in the images"
        ))
    })?;
    Ok(camera_of_mirror(mirror, size_px))
}

/// Width and height of an image as its camera stood.
pub(crate) fn size_px(first: &ImageFile) -> Result<(u32, u32), Failure> {
    let file = File::open(&first.path).map_err(Failure::file("read", &first.path))?;
    upright_size_px(BufReader::new(file)).map_err(|error| {
        Failure::Unfit(format!(
            "{} is no image that can be read: {error}; send JPEG or PNG",
            first.path.display()
        ))
    })
}

/// The camera of panoramas of a width and a height.
///
/// # Errors
/// [`Failure`] if images are as high as photographs: a panorama covers 360 degrees, and even one that looks straight up
/// and down is twice as wide as high.
pub(crate) fn panorama_camera(projection: Projection, size_px: (u32, u32)) -> Result<v1::Camera, Failure> {
    let (width_px, height_px) = size_px;
    if width_px < height_px.saturating_mul(2) {
        return Err(Failure::Unfit(format!(
            "images of {width_px} x {height_px} pixels are no panoramas: one covers 360 degrees, and is at least twice as wide \
             as high; leave out --panorama, or unroll them first"
        )));
    }
    Ok(camera_of(projection, size_px))
}

/// The same for a size that is known to be that of a panorama.
pub(crate) fn camera_of(projection: Projection, (image_width_px, image_height_px): (u32, u32)) -> v1::Camera {
    // Half of the height, in widths of a circle of radius 1.
    let half = PI * f64::from(image_height_px) / f64::from(image_width_px.max(1));
    let (projection, vertical_rad) = match projection {
        Projection::Cylindrical => (v1::panorama::Projection::Cylindrical, 2.0 * half.atan()),
        Projection::Equirectangular => (v1::panorama::Projection::Equirectangular, 2.0 * half),
    };
    let panorama = v1::Panorama { projection: projection.into(), vertical_rad: Some(vertical_rad) };
    let model = Some(v1::camera::Model::Panorama(panorama));
    v1::Camera {
        model,
        image_width_px: Some(image_width_px),
        image_height_px: Some(image_height_px),
        base_to_camera: None,
    }
}

fn camera_of_mirror(mirror: Mirror, (image_width_px, image_height_px): (u32, u32)) -> v1::Camera {
    let Mirror {
        center_x_px,
        center_y_px,
        inner_radius_px,
        outer_radius_px,
        eccentricity,
        horizon_radius_px,
        ahead_rad,
    } = mirror;
    let mirror = v1::HyperbolicMirror {
        center_x_px,
        center_y_px,
        inner_radius_px,
        outer_radius_px,
        eccentricity,
        horizon_radius_px: Some(horizon_radius_px),
        ahead_rad,
    };
    let model = Some(v1::camera::Model::HyperbolicMirror(mirror));
    v1::Camera {
        model,
        image_width_px: Some(image_width_px),
        image_height_px: Some(image_height_px),
        base_to_camera: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A server holds the numbers against the whole image.
    #[test]
    fn a_mirror_too_large_for_a_server_is_not_made_smaller() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mirror.json");
        let mirror = r#"{"center_x_px": 2400, "center_y_px": 1800, "inner_radius_px": 200, "outer_radius_px": 1700,
            "eccentricity": 1.2, "horizon_radius_px": 1100}"#;
        std::fs::write(&file, mirror).unwrap();
        assert!(mirror_camera(&file, (4600, 3400)).is_ok());
        let refused = mirror_camera(&file, (4800, 3600)).unwrap_err().to_string();
        assert!(refused.contains("16 megapixels") && refused.contains("make them smaller"), "{refused}");
    }

    #[test]
    fn square_pixels_say_how_far_up_a_panorama_looks() {
        let vertical_rad = |projection, size| match camera_of(projection, size).model {
            Some(v1::camera::Model::Panorama(panorama)) => panorama.vertical_rad.unwrap_or_default(),
            other => panic!("{other:?}"),
        };
        assert!((vertical_rad(Projection::Equirectangular, (1024, 512)) - PI).abs() < 1e-12);
        // The slope at the upper edge is 1 where the height is the width over π.
        let cylinder = vertical_rad(Projection::Cylindrical, (314_159, 100_000));
        assert!((cylinder - PI / 2.0).abs() < 1e-5, "{cylinder}");
    }
}
