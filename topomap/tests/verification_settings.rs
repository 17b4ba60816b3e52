//! Settings of the verification that are out of range.

use topomap::evidence::{Quantity, VerificationError, VerificationSettings};
use topomap::mapper::Mapper;
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
