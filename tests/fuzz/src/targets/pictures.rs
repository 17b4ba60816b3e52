//! Images, and what is kept of them.

use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::image::{MAX_PIXELS, MAX_SIDE_PX, decode};

use crate::Fed;

/// A JPEG or PNG.
pub(super) fn image(bytes: &[u8]) -> Fed {
    let image = match decode(bytes) {
        Ok(image) => image,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return Fed::Refused;
        }
    };
    let (width, height) = (image.width(), image.height());
    assert!(u64::from(width) * u64::from(height) <= MAX_PIXELS && width.max(height) <= MAX_SIDE_PX);
    // As it is kept.
    let small = image.resize_to_width(64).unwrap();
    let kept = small.encode_jpeg(80).unwrap();
    assert!(!kept.is_empty());
    Fed::Taken
}

/// The features of an image, as a snapshot brings them.
pub(super) fn features(bytes: &[u8]) -> Fed {
    let Ok(features) = FeatureRecord::from_bytes(bytes) else { return Fed::Refused };
    let written = features.to_bytes();
    let again = FeatureRecord::from_bytes(&written).expect("what is written is read");
    assert_eq!(again.to_bytes(), written);
    assert_eq!(features.keypoints().len(), features.words().len());
    Fed::Taken
}
