//! The features of a frame as a map keeps them, so that geometry, and words of another vocabulary,
//! can be computed later.

use fabmap::codec::{DecodeError, Reader, Writer};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::observation::WordId;

use crate::depth::{InverseDepth, Structure};
use crate::features::Keypoint;

/// Where the features of an image are, which words they are, and how they look.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureRecord {
    image_width_px: u32,
    image_height_px: u32,
    keypoints: Vec<Keypoint>,
    words: Vec<WordId>,
    descriptors: Option<Descriptors>,
    structure: Structure,
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

/// Version of the byte form; 2 added depths. What has none is written as before.
const VERSION: u8 = 2;
const VERSION_WITHOUT_STRUCTURE: u8 = 1;

/// Bytes of a keypoint.
const KEYPOINT_BYTES: usize = 20;

impl FeatureRecord {
    /// Feature `i` is keypoint `i`, word `i` and descriptor row `i`. A robot that sends words has
    /// no descriptors to give.
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
            let keypoints = keypoints.len();
            let words = words.len();
            return Err(UnevenFeatures { keypoints, words, descriptors: described });
        }
        let structure = Structure::default();
        Ok(Self { image_width_px, image_height_px, keypoints, words, descriptors, structure })
    }

    /// The same features with what is known of their depths: of each, or of none.
    #[must_use]
    pub(crate) fn with_structure(self, structure: Structure) -> Self {
        Self { structure, ..self }
    }

    /// How far the features are, as far as that is known.
    #[must_use]
    pub fn structure(&self) -> &Structure {
        &self.structure
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

    /// The byte form: 20 bytes a keypoint, a word of 1 to 3 bytes, the descriptor as it is, and 8
    /// bytes a depth if some are known.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { image_width_px, image_height_px, keypoints, words, descriptors, structure } = self;
        let mut writer = Writer::default();
        writer.u8(if structure.depths().is_empty() { VERSION_WITHOUT_STRUCTURE } else { VERSION });
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
        if !structure.depths().is_empty() {
            encode_structure(structure, &mut writer);
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
        if !(VERSION_WITHOUT_STRUCTURE..=VERSION).contains(&version) {
            return Err(DecodeError::Version { found: version.into(), newest: VERSION.into() });
        }
        let image_size_px = (reader.varint_u32()?, reader.varint_u32()?);
        let count = reader.count(KEYPOINT_BYTES)?;
        let keypoints = (0..count).map(|_| keypoint(&mut reader)).collect::<Result<Vec<_>, _>>()?;
        let words =
            (0..count).map(|_| reader.varint_u32().map(WordId::new)).collect::<Result<Vec<_>, _>>()?;
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
        let structure = if version == VERSION_WITHOUT_STRUCTURE {
            Structure::default()
        } else {
            decode_structure(&mut reader, count)?
        };
        reader.end()?;
        let features =
            Self::new(image_size_px, keypoints, words, descriptors).map_err(DecodeError::invalid)?;
        Ok(features.with_structure(structure))
    }
}

/// A depth that is not known has a standard deviation of 0.
fn encode_structure(structure: &Structure, writer: &mut Writer) {
    for depth in structure.depths() {
        let [per_m, sigma_per_m] = depth.map_or([0.0; 2], |depth| [depth.per_m, depth.sigma_per_m]);
        [per_m, sigma_per_m].into_iter().for_each(|value| writer.u32((value as f32).to_bits()));
    }
}

fn decode_structure(reader: &mut Reader<'_>, count: usize) -> Result<Structure, DecodeError> {
    let depths = (0..count).map(|_| {
        let per_m = f64::from(f32::from_bits(reader.u32()?));
        let sigma_per_m = f64::from(f32::from_bits(reader.u32()?));
        if per_m < 0.0 || sigma_per_m < 0.0 || !per_m.is_finite() || !sigma_per_m.is_finite() {
            return Err(DecodeError::invalid("a depth that is none"));
        }
        Ok((sigma_per_m > 0.0).then_some(InverseDepth { per_m, sigma_per_m }))
    });
    Ok(Structure::new(depths.collect::<Result<_, _>>()?))
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
        let records = (features, any::<bool>(), 1..9000u32, 1..9000u32);
        let records = records.prop_map(|(features, described, width, height)| {
            let keypoints = features.iter().map(|(values, ..)| {
                let [x_px, y_px, size_px, angle_rad, response] = values.map(f32::from);
                Keypoint { x_px, y_px, size_px, angle_rad, response }
            });
            let words = features.iter().map(|&(_, word, _)| WordId::new(word)).collect();
            let rows: Vec<u8> = features.iter().flat_map(|(.., row)| *row).collect();
            let descriptors = described.then(|| Descriptors::new(DescriptorKind::Binary, 32, rows).unwrap());
            FeatureRecord::new((width, height), keypoints.collect(), words, descriptors).unwrap()
        });
        (records, any::<bool>(), 0.01..4.0f32).prop_map(|(record, has_depths, nearest)| {
            // Every third is not known.
            let depth = |index: usize| {
                let per_m = f64::from(nearest) / (index + 1) as f64;
                let rounded = f64::from(per_m as f32);
                (!index.is_multiple_of(3)).then_some(InverseDepth { per_m: rounded, sigma_per_m: 0.125 })
            };
            let depths = (0..record.keypoints().len()).map(depth).collect();
            if has_depths { record.with_structure(Structure::new(depths)) } else { record }
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
            for version in [VERSION_WITHOUT_STRUCTURE, VERSION] {
                let versioned: Vec<u8> = std::iter::once(version).chain(bytes.clone()).collect();
                let _ = FeatureRecord::from_bytes(&versioned);
            }
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
            ((640, 480), &[keypoint][..], &[WordId::new(133)][..])
        );
        assert_eq!(record.descriptors().map(Descriptors::as_bytes), Some(&[7, 9][..]));
        assert_eq!(record.to_bytes(), bytes);
    }

    /// The same of version 2, with a depth of 4 m.
    #[test]
    fn the_second_version_opens() {
        let bytes = [
            2, 0x80, 5, 0xe0, 3, 1, 0, 0, 0x80, 0x3f, 0, 0, 0, 0x40, 0, 0, 0x40, 0x40, 0, 0, 0, 0x3f, 0, 0,
            0, 0, 0x85, 1, 2, 2, 7, 9, 0, 0, 0x80, 0x3e, 0, 0, 0, 0x3d,
        ];
        let record = FeatureRecord::from_bytes(&bytes).unwrap();
        let depth = InverseDepth { per_m: 0.25, sigma_per_m: 0.03125 };
        assert_eq!(record.structure().depths(), [Some(depth)]);
        assert_eq!(record.to_bytes(), bytes);
    }
}
