use nalgebra::UnitQuaternion;

use super::super::two_view::Similarity;
use super::*;

fn shifted(shift_widths: f64, ln_scale: f64) -> TwoView {
    let motion = Similarity { rotation_rad: 0.0, ln_scale, translation_widths: [shift_widths, 0.0] };
    let motion = Some(ViewMotion::Similarity(motion));
    TwoView { matches: 50, inliers: 40, distinct_inliers: 30, motion, placement: Placement::Unknown }
}

/// The paper's example: 33 pixels of 320 are 4.73 degrees, seen by a camera of 43.7 degrees.
#[test]
fn an_image_that_has_moved_right_was_seen_by_a_robot_that_turned_left() {
    let noise = ClosureNoise::of_spacing(0.5);
    let focal_length_widths = 33.0 / 320.0 / 4.73_f64.to_radians().tan();
    let measured = noise.measure(&shifted(33.0 / 320.0, 0.0), Some(focal_length_widths)).unwrap();
    assert!((measured.pose().heading_rad().to_degrees() - 4.73).abs() < 1e-9);
    assert!((measured.covariance()[(0, 0)].sqrt() - 0.25).abs() < 1e-12);
    assert_eq!(noise.measure(&shifted(0.0, 0.4), Some(1.0)), None, "too near or too far");
    assert_eq!(noise.measure(&shifted(0.3, 0.0), None), None, "an angle that nobody knows");
    let upright = noise.measure(&shifted(0.05, 0.0), None).unwrap();
    assert_eq!(upright.pose().heading_rad(), 0.0);
    // The same turn as a camera's own motion: things move to the right in its image.
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.2);
    let turned = rotation * Vector3::z();
    assert!(turned.x > 0.0);
    let direction = nalgebra::UnitVector3::new_normalize(Vector3::x());
    let motion = Some(ViewMotion::Essential { rotation, direction });
    let seen = noise.measure(&TwoView { motion, ..shifted(0.0, 0.0) }, None).unwrap();
    assert!((seen.pose().heading_rad() - 0.2).abs() < 1e-12);
}
