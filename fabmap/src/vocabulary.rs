//! The visual vocabulary: which word a descriptor is.

mod dbow_yaml;
mod error;
mod fbow;
mod import;
mod orb_text;
mod settings;
mod training;

use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::{DescriptorError, DescriptorKind, Descriptors};
use crate::observation::{Observation, WordId};
use crate::quantizer::{Centres, Quantizer};

pub use crate::quantizer::TreeError;
pub use dbow_yaml::DbowYamlError;
pub use error::VocabularyError;
pub use fbow::FbowError;
pub use import::ImportError;
pub use orb_text::OrbVocabularyError;
pub use settings::VocabularySettings;
pub use training::{TrainingProgress, TrainingStage};

/// Bytes of an ORB descriptor.
const ORB_BYTES: usize = 32;

/// A visual vocabulary with its quantizer: each descriptor is the word it is nearest to.
///
/// Distances are integers and equal ones go to the lowest word, so a descriptor has the same word
/// on every machine and on any number of threads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vocabulary {
    kind: DescriptorKind,
    width: usize,
    quantizer: Quantizer,
}

impl Vocabulary {
    fn new(kind: DescriptorKind, width: usize, quantizer: Quantizer) -> Self {
        Self { kind, width, quantizer }
    }

    /// Reads the text format of ORB vocabularies (`ORBvoc.txt`), as DBoW2 writes it. Words are the
    /// leaves in file order and the tree is kept: descriptors get the words that DBoW2 gives them.
    ///
    /// # Errors
    /// [`OrbVocabularyError`] with the line that is wrong.
    pub fn from_orb_text(text: &str) -> Result<Self, OrbVocabularyError> {
        let tree = orb_text::parse(text)?;
        Ok(Self::new(DescriptorKind::Binary, ORB_BYTES, Quantizer::Descent(tree)))
    }

    /// Reads the file of another program's ORB vocabulary, whichever of these it is: the text format
    /// (see [`Vocabulary::from_orb_text`]), YAML of DBoW2 or DBoW3, or the binary format of FBoW. Words
    /// are the leaves and the tree is kept: descriptors get the words that those programs give them,
    /// with the numbers that DBoW2 gives them in training.
    ///
    /// What gzip packed has to be unpacked before.
    ///
    /// # Errors
    /// [`ImportError`], with what is wrong and where.
    pub fn import(bytes: &[u8]) -> Result<Self, ImportError> {
        let tree = import::parse(bytes)?;
        Ok(Self::new(DescriptorKind::Binary, ORB_BYTES, Quantizer::Descent(tree)))
    }

    /// Number of words.
    #[must_use]
    pub fn len(&self) -> usize {
        self.quantizer.len()
    }

    /// False: a vocabulary has a word at least.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Kind of the descriptors it quantizes.
    #[must_use]
    pub fn kind(&self) -> DescriptorKind {
        self.kind
    }

    /// Bytes of a descriptor.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// The descriptor that each word stands for, in order of word.
    #[must_use]
    pub fn centres(&self) -> Descriptors {
        Descriptors::new(self.kind, self.width, self.quantizer.word_rows())
            .unwrap_or_else(|_| unreachable!("every quantizer has whole rows of width()"))
    }

    /// The same words, but each descriptor is compared with every one of them: the exact answer
    /// that the searches of large vocabularies are measured against.
    #[must_use]
    pub fn with_exact_search(&self) -> Self {
        let centres = Centres::pack(self.kind, self.width, self.centres().as_bytes());
        Self::new(self.kind, self.width, Quantizer::Exact(centres))
    }

    /// Word of one descriptor.
    ///
    /// # Panics
    /// If the descriptor has not [`Vocabulary::width`] bytes.
    #[must_use]
    pub fn word(&self, descriptor: &[u8]) -> WordId {
        assert_eq!(descriptor.len(), self.width, "bytes of the descriptor");
        self.quantizer.word(descriptor)
    }

    /// Word of each descriptor, in order; on all threads.
    ///
    /// # Errors
    /// [`VocabularyError::Descriptors`] if kind or width are not the vocabulary's.
    pub fn words(&self, descriptors: &Descriptors) -> Result<Vec<WordId>, VocabularyError> {
        if (descriptors.kind(), descriptors.width()) != (self.kind, self.width) {
            return Err(VocabularyError::Descriptors(DescriptorError::Mismatch {
                expected: self.kind,
                expected_width: self.width,
                found: descriptors.kind(),
                found_width: descriptors.width(),
            }));
        }
        Ok(self.quantizer.words(self.width, descriptors.as_bytes()))
    }

    /// What an image with these descriptors shows.
    ///
    /// # Errors
    /// See [`Vocabulary::words`].
    pub fn observe(&self, descriptors: &Descriptors) -> Result<Observation, VocabularyError> {
        let observation = Observation::from_words(self.words(descriptors)?, self.len());
        Ok(observation.unwrap_or_else(|_| unreachable!("every quantizer's words are below len()")))
    }

    /// Appends the byte form: kind, width, quantizer, then the centres as bytes.
    pub fn encode(&self, writer: &mut Writer) {
        writer.u8(match self.kind {
            DescriptorKind::Float => 0,
            DescriptorKind::Binary => 1,
        });
        writer.varint(self.width as u64);
        self.quantizer.encode(writer);
    }

    /// Reads what [`Vocabulary::encode`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut or not a vocabulary.
    pub fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let kind = match reader.u8()? {
            0 => DescriptorKind::Float,
            1 => DescriptorKind::Binary,
            other => return Err(DecodeError::invalid(format_args!("descriptor kind {other}"))),
        };
        let width = reader.varint_u32()? as usize;
        if width == 0 || width > Descriptors::MAX_WIDTH {
            return Err(DecodeError::invalid(format_args!("descriptors of {width} bytes")));
        }
        Ok(Self::new(kind, width, Quantizer::decode(kind, width, reader)?))
    }
}

#[cfg(test)]
mod test_vocabularies;
#[cfg(test)]
mod tests;
