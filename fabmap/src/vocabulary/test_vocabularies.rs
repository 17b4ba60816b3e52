//! Descriptors around random centres, and byte forms, that tests of vocabularies share.

use std::ops::ControlFlow;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{TrainingProgress, Vocabulary, VocabularySettings};
use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::{DescriptorKind, Descriptors};

pub(crate) const KINDS: [DescriptorKind; 2] = [DescriptorKind::Float, DescriptorKind::Binary];

pub(crate) fn silent(_: TrainingProgress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

pub(crate) fn settings(words: u32) -> VocabularySettings {
    VocabularySettings { words, ..VocabularySettings::default() }
}

/// Random rows with slightly different copies of each, group by group: float values differ by up to
/// 6 of 255, binary rows in up to `width / 16` bits. `noise` makes other copies of the same rows.
pub(crate) fn clustered(
    kind: DescriptorKind,
    width: usize,
    groups: usize,
    members: usize,
    noise: u64,
) -> Descriptors {
    let mut centres = ChaCha8Rng::seed_from_u64(1);
    let mut noise = ChaCha8Rng::seed_from_u64(noise);
    let mut bytes = Vec::with_capacity(groups * members * width);
    for _ in 0..groups {
        let group: Vec<u8> = (0..width).map(|_| centres.random()).collect();
        for _ in 0..members {
            let start = bytes.len();
            bytes.extend_from_slice(&group);
            match kind {
                DescriptorKind::Float => {
                    for value in &mut bytes[start..] {
                        *value = value.saturating_add_signed(noise.random_range(-6..=6));
                    }
                }
                DescriptorKind::Binary => {
                    for _ in 0..width.div_ceil(16) {
                        bytes[start + noise.random_range(0..width)] ^= 1 << noise.random_range(0..8);
                    }
                }
            }
        }
    }
    Descriptors::new(kind, width, bytes).unwrap()
}

pub(crate) fn encoded(vocabulary: &Vocabulary) -> Vec<u8> {
    let mut writer = Writer::default();
    vocabulary.encode(&mut writer);
    writer.into_bytes()
}

pub(crate) fn decoded(bytes: &[u8]) -> Result<Vocabulary, DecodeError> {
    let mut reader = Reader::new(bytes);
    let vocabulary = Vocabulary::decode(&mut reader)?;
    reader.end()?;
    Ok(vocabulary)
}
