//! Whether cameras are a reason why maps do not meet.

use std::f64::consts::TAU;

use crate::camera::{Camera, CameraModel};

/// Cameras that see so differently show one place at sizes, or with edges, by which it is often not found again.
const FAR_APART_DEG: f64 = 10.0;

/// That no camera of the one map sees as wide as one of the other, in words; `None` where one does, or a map declares none.
pub(super) fn difference(source: (&str, &[Camera]), target: (&str, &[Camera])) -> Option<String> {
    let angles = |cameras: &[Camera]| cameras.iter().filter_map(across_deg).collect::<Vec<f64>>();
    let (of_source, of_target) = (angles(source.1), angles(target.1));
    let pairs = of_source.iter().flat_map(|one| of_target.iter().map(move |other| [*one, *other]));
    let nearest = pairs.min_by(|one, other| apart_deg(one).total_cmp(&apart_deg(other)))?;
    let [source_deg, target_deg] = nearest;
    (apart_deg(&nearest) > FAR_APART_DEG).then(|| {
        format!(
            "{} was mapped by a camera that sees {source_deg:.0} degrees across, {} by one that sees {target_deg:.0}: images of so \
             different cameras often do not match; drive the way that both have with one of them",
            source.0, target.0
        )
    })
}

fn apart_deg([one, other]: &[f64; 2]) -> f64 {
    (one - other).abs()
}

/// How much a camera sees from its left to its right edge; a lens's distortion is left out.
fn across_deg(camera: &Camera) -> Option<f64> {
    let width_px = || camera.image_size_px.map(|(width, _)| f64::from(width));
    let radians = match camera.model.as_ref()? {
        CameraModel::Pinhole { focal_px: [focal_px, _], .. } => 2.0 * (width_px()? / 2.0 / focal_px).atan(),
        CameraModel::Fisheye { focal_px: [focal_px, _], .. } => (width_px()? / focal_px).min(TAU),
        CameraModel::FieldOfView { horizontal_rad } => *horizontal_rad,
        CameraModel::Cylindrical { .. }
        | CameraModel::Equirectangular { .. }
        | CameraModel::HyperbolicMirror(_) => TAU,
    };
    Some(radians.to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn narrow() -> Camera {
        let model = CameraModel::Pinhole {
            focal_px: [320.0, 320.0],
            center_px: [160.0, 120.0],
            distortion: Vec::new(),
        };
        // 2 atan(1/2), 53 degrees.
        Camera { model: Some(model), image_size_px: Some((320, 240)), base_to_camera: None }
    }

    fn of_degrees(horizontal_deg: f64) -> Camera {
        let model = CameraModel::FieldOfView { horizontal_rad: horizontal_deg.to_radians() };
        Camera { model: Some(model), ..Camera::default() }
    }

    #[test]
    fn the_pair_of_cameras_that_is_nearest_counts() {
        let both = [of_degrees(120.0), of_degrees(60.0)];
        assert_eq!(difference(("a", &[narrow()]), ("b", &both)), None);
        let told = difference(("a", &[narrow()]), ("b", &both[..1])).unwrap();
        assert!(
            told.starts_with("a was mapped by a camera that sees 53 degrees across, b by one that sees 120:"),
            "{told}"
        );
    }

    #[test]
    fn panoramas_see_all_around() {
        let model = Some(CameraModel::Cylindrical { vertical_rad: 1.0 });
        let panorama = [Camera { model, ..Camera::default() }];
        let told = difference(("a", &panorama), ("b", &[narrow()])).unwrap();
        assert!(told.contains("360 degrees across"), "{told}");
        assert_eq!(difference(("a", &panorama), ("b", &panorama)), None);
    }

    #[test]
    fn what_nobody_declared_is_no_reason() {
        assert_eq!(difference(("a", &[]), ("b", &[narrow()])), None);
        let unknown = Camera { image_size_px: None, ..narrow() };
        assert_eq!(difference(("a", &[unknown]), ("b", &[of_degrees(120.0)])), None);
    }
}
