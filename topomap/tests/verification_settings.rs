//! Settings of the verification that are out of range.

use topomap::evidence::{Quantity, VerificationError, VerificationSettings};
use topomap::mapper::Mapper;
use topomap::metric::{Odometry, PlaceSpacing};
use topomap::settings::{MapperError, MapperSettings};

use crate::look_alikes::{model, settings};

#[test]
fn settings_out_of_range_are_refused() {
    let refused = |verification| {
        let settings = MapperSettings { verification, ..settings() };
        match Mapper::new(&model(), settings).unwrap_err() {
            MapperError::Verification(error) => error,
            other => panic!("{other}"),
        }
    };
    let good = VerificationSettings::default();
    let improbable = VerificationSettings { min_posterior: 1.5, ..good };
    assert_eq!(refused(improbable), VerificationError::MinPosterior { value: 1.5 });
    assert_eq!(refused(VerificationSettings { min_inliers: 0, ..good }), VerificationError::MinInliers);
    for (settings, quantity) in [
        (VerificationSettings { max_rotation_rad: 0.0, ..good }, Quantity::RotationRad),
        (VerificationSettings { max_ln_scale: -1.0, ..good }, Quantity::LnScale),
        (VerificationSettings { max_translation_widths: 0.0, ..good }, Quantity::TranslationWidths),
    ] {
        assert!(
            matches!(refused(settings), VerificationError::Bound { quantity: found, .. } if found == quantity)
        );
    }
    let forgetless = VerificationSettings { consistency_frames: 101, ..good };
    assert_eq!(refused(forgetless), VerificationError::ConsistencyFrames { value: 101 });
}

/// With wheels, views that are turned further than a place reaches are not of one place.
#[test]
fn a_wide_camera_bounds_how_far_the_image_may_move() {
    let wheels = Odometry::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], None).unwrap();
    let bound = |settings: MapperSettings, odometry: Option<&Odometry>, focal_length_widths| {
        settings.for_frame(odometry, focal_length_widths).verification.max_translation_widths
    };
    // 85 degrees wide: 30 degrees move the image by 0.315 widths, where half a width may do without.
    let wide = 0.5 / 42.5_f64.to_radians().tan();
    let expected = wide * 30_f64.to_radians().tan();
    assert!((bound(settings(), Some(&wheels), Some(wide)) - expected).abs() < 1e-12);
    assert_eq!(bound(settings(), None, Some(wide)), 0.5);
    assert_eq!(bound(settings(), Some(&wheels), None), 0.5);
    // A long lens sees less than that, and a place that reaches all around is seen from everywhere.
    assert_eq!(bound(settings(), Some(&wheels), Some(2.0)), 0.5);
    let place_spacing = PlaceSpacing { distance_m: 0.5, angle_rad: 1.0 };
    assert_eq!(bound(MapperSettings { place_spacing, ..settings() }, Some(&wheels), Some(wide)), 0.5);
}
