//! The features of a frame as a map keeps them: what geometry, and words of another vocabulary, can be
//! made of later.

use fabmap::codec::{DecodeError, Reader, Writer};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::observation::WordId;

use crate::features::Keypoint;

/// Where the features of an image are, which words they are, and how they look.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureRecord {
    image_width_px: u32,
    image_height_px: u32,
    keypoints: Vec<Keypoint>,
    words: Vec<WordId>,
    descriptors: Option<Descriptors>,
}

/// Why lists are not the features of one image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{keypoints} keypoints, {words} words and {descriptors:?} descriptors are not of one image; send one of each a feature"
)]
pub struct UnevenFeatures {
    /// Number of keypoints.
    pub keypoints: usize,
    /// Number of words.
    pub words: usize,
    /// Number of descriptors, if there are any.
    pub descriptors: Option<usize>,
}

/// Version of the byte form.
const VERSION: u8 = 1;

/// Bytes of a keypoint.
const KEYPOINT_BYTES: usize = 20;

impl FeatureRecord {
    /// Feature `i` is keypoint `i`, word `i` and descriptor row `i`. A robot that sends words has no
    /// descriptors to give.
    ///
    /// # Errors
    /// [`UnevenFeatures`] if the lists differ in length.
    pub fn new(
        (image_width_px, image_height_px): (u32, u32),
        keypoints: Vec<Keypoint>,
        words: Vec<WordId>,
        descriptors: Option<Descriptors>,
    ) -> Result<Self, UnevenFeatures> {
        let described = descriptors.as_ref().map(Descriptors::len);
        if words.len() != keypoints.len() || described.is_some_and(|described| described != keypoints.len()) {
            let (keypoints, words) = (keypoints.len(), words.len());
            return Err(UnevenFeatures { keypoints, words, descriptors: described });
        }
        Ok(Self { image_width_px, image_height_px, keypoints, words, descriptors })
    }

    /// Size of the image that the keypoints are in: width and height in pixels.
    #[must_use]
    pub fn image_size_px(&self) -> (u32, u32) {
        (self.image_width_px, self.image_height_px)
    }

    /// Where the features are.
    #[must_use]
    pub fn keypoints(&self) -> &[Keypoint] {
        &self.keypoints
    }

    /// Which word each is.
    #[must_use]
    pub fn words(&self) -> &[WordId] {
        &self.words
    }

    /// How each looks, if the image came to the server.
    #[must_use]
    pub fn descriptors(&self) -> Option<&Descriptors> {
        self.descriptors.as_ref()
    }

    /// The byte form: 20 bytes a keypoint, a word of 1 to 3 bytes, and the descriptor as it is.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { image_width_px, image_height_px, keypoints, words, descriptors } = self;
        let mut writer = Writer::default();
        writer.u8(VERSION);
        writer.varint(u64::from(*image_width_px));
        writer.varint(u64::from(*image_height_px));
        writer.varint(keypoints.len() as u64);
        for Keypoint { x_px, y_px, size_px, angle_rad, response } in keypoints {
            for value in [x_px, y_px, size_px, angle_rad, response] {
                writer.u32(value.to_bits());
            }
        }
        words.iter().for_each(|&word| writer.varint(u64::from(word)));
        match descriptors {
            None => writer.u8(0),
            Some(descriptors) => {
                writer.u8(match descriptors.kind() {
                    DescriptorKind::Float => 1,
                    DescriptorKind::Binary => 2,
                });
                writer.varint(descriptors.width() as u64);
                writer.raw(descriptors.as_bytes());
            }
        }
        writer.into_bytes()
    }

    /// Reads what [`FeatureRecord::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut, newer than this program, or no features.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(bytes);
        let version = reader.u8()?;
        if version != VERSION {
            return Err(DecodeError::Version { found: version.into(), newest: VERSION.into() });
        }
        let image_size_px = (reader.varint_u32()?, reader.varint_u32()?);
        let count = reader.count(KEYPOINT_BYTES)?;
        let keypoints = (0..count).map(|_| keypoint(&mut reader)).collect::<Result<Vec<_>, _>>()?;
        let words = (0..count).map(|_| reader.varint_u32()).collect::<Result<Vec<_>, _>>()?;
        let kind = match reader.u8()? {
            0 => None,
            1 => Some(DescriptorKind::Float),
            2 => Some(DescriptorKind::Binary),
            other => return Err(DecodeError::invalid(format_args!("descriptor kind {other}"))),
        };
        let descriptors = match kind {
            None => None,
            Some(kind) => {
                let width = usize::try_from(reader.varint()?).unwrap_or(usize::MAX);
                let rows = reader.raw(count.saturating_mul(width))?.to_vec();
                Some(Descriptors::new(kind, width, rows).map_err(DecodeError::invalid)?)
            }
        };
        reader.end()?;
        Self::new(image_size_px, keypoints, words, descriptors).map_err(DecodeError::invalid)
    }
}

fn keypoint(reader: &mut Reader<'_>) -> Result<Keypoint, DecodeError> {
    let mut value = || Ok::<_, DecodeError>(f32::from_bits(reader.u32()?));
    Ok(Keypoint {
        x_px: value()?,
        y_px: value()?,
        size_px: value()?,
        angle_rad: value()?,
        response: value()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn records() -> impl Strategy<Value = FeatureRecord> {
        let features =
            proptest::collection::vec((any::<[u16; 5]>(), 0..1_000_000u32, any::<[u8; 32]>()), 0..30);
        (features, any::<bool>(), 1..9000u32, 1..9000u32).prop_map(|(features, described, width, height)| {
            let keypoints = features.iter().map(|(values, ..)| {
                let [x_px, y_px, size_px, angle_rad, response] = values.map(f32::from);
                Keypoint { x_px, y_px, size_px, angle_rad, response }
            });
            let words = features.iter().map(|&(_, word, _)| word).collect();
            let rows: Vec<u8> = features.iter().flat_map(|(.., row)| *row).collect();
            let descriptors = described.then(|| Descriptors::new(DescriptorKind::Binary, 32, rows).unwrap());
            FeatureRecord::new((width, height), keypoints.collect(), words, descriptors).unwrap()
        })
    }

    proptest! {
        #[test]
        fn bytes_give_the_features_back(record in records(), cut in any::<prop::sample::Index>()) {
            let bytes = record.to_bytes();
            prop_assert_eq!(FeatureRecord::from_bytes(&bytes), Ok(record));
            prop_assert!(FeatureRecord::from_bytes(&bytes[..cut.index(bytes.len())]).is_err());
        }

        #[test]
        fn damaged_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = FeatureRecord::from_bytes(&bytes);
            let versioned: Vec<u8> = std::iter::once(VERSION).chain(bytes).collect();
            let _ = FeatureRecord::from_bytes(&versioned);
        }
    }

    /// Records of version 1 must open for ever.
    #[test]
    fn the_first_version_opens() {
        let bytes = [
            1, 0x80, 5, 0xe0, 3, 1, 0, 0, 0x80, 0x3f, 0, 0, 0, 0x40, 0, 0, 0x40, 0x40, 0, 0, 0, 0x3f, 0, 0,
            0, 0, 0x85, 1, 2, 2, 7, 9,
        ];
        let record = FeatureRecord::from_bytes(&bytes).unwrap();
        let keypoint = Keypoint { x_px: 1.0, y_px: 2.0, size_px: 3.0, angle_rad: 0.5, response: 0.0 };
        assert_eq!(
            (record.image_size_px(), record.keypoints(), record.words()),
            ((640, 480), &[keypoint][..], &[133][..])
        );
        assert_eq!(record.descriptors().map(Descriptors::as_bytes), Some(&[7, 9][..]));
        assert_eq!(record.to_bytes(), bytes);
    }
}
