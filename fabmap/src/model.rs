//! The model: everything that is learnt before a robot drives, in one immutable file.

mod training;

pub use training::{ModelTrainingError, ModelTrainingProgress, ModelTrainingSettings, TrainingStage};

use std::fmt;
use std::str::FromStr;

use sha2::{Digest, Sha256};

use crate::chow_liu::ChowLiuTree;
use crate::codec::{Container, DecodeError, Reader, Writer};
use crate::detector::DetectorModel;
use crate::evidence_exponent::EvidenceExponent;
use crate::look_alikes::{Kinds, LookAlikes};
use crate::observation::{Observation, WordId};
use crate::vocabulary::Vocabulary;

/// Extractor, vocabulary, Chow-Liu tree, detector model with its calibration, and sampling set.
/// Immutable, and named by the hash of its content.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    extractor: String,
    vocabulary: Vocabulary,
    tree: ChowLiuTree,
    detector: DetectorModel,
    sampling_set: Vec<Observation>,
    evidence_exponent: EvidenceExponent,
    look_alikes: Option<LookAlikes>,
}

/// SHA-256 of a content, shown as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ContentHash([u8; 32]);

/// The parts do not belong together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// Tree and vocabulary differ in size.
    #[error("the tree has {tree} words, the vocabulary {vocabulary}; train the tree on this vocabulary")]
    TreeSize {
        /// Words of the tree.
        tree: usize,
        /// Words of the vocabulary.
        vocabulary: usize,
    },
    /// A sample has a word that the vocabulary does not.
    #[error("the sampling set has word {word}, the vocabulary {vocabulary} words; quantize the samples anew")]
    SampleWord {
        /// The word.
        word: WordId,
        /// Words of the vocabulary.
        vocabulary: usize,
    },
}

/// `.waypost` model files.
const CONTAINER: Container = Container { magic: *b"WPMODEL\n", name: "Waypost model", version: 3 };

/// A model whose likelihoods count in full is written as version 1 wrote it, byte by byte: its name
/// is the hash of these bytes, and maps know it by that name.
const WITHOUT_EXPONENT: Container = Container { version: 1, ..CONTAINER };

/// The same for models that know nothing of look-alikes.
const WITHOUT_LOOK_ALIKES: Container = Container { version: 2, ..CONTAINER };

impl Model {
    /// Joins the parts. `extractor` names feature and settings that the words are made of, in the
    /// extractor's own canonical text; this crate does not read it.
    ///
    /// # Errors
    /// [`ModelError`] if the parts are of different vocabularies.
    pub fn new(
        extractor: String,
        vocabulary: Vocabulary,
        tree: ChowLiuTree,
        detector: DetectorModel,
        sampling_set: Vec<Observation>,
    ) -> Result<Self, ModelError> {
        if tree.len() != vocabulary.len() {
            return Err(ModelError::TreeSize { tree: tree.len(), vocabulary: vocabulary.len() });
        }
        let last_words = sampling_set.iter().filter_map(|sample| sample.words().last());
        if let Some(&word) = last_words.max().filter(|&&word| word.index() >= vocabulary.len()) {
            return Err(ModelError::SampleWord { word, vocabulary: vocabulary.len() });
        }
        let evidence_exponent = EvidenceExponent::NONE;
        let look_alikes = None;
        Ok(Self { extractor, vocabulary, tree, detector, sampling_set, evidence_exponent, look_alikes })
    }

    /// Another model over the same words: with this detector, and likelihoods to this exponent.
    #[must_use]
    pub fn recalibrated(&self, detector: DetectorModel, evidence_exponent: EvidenceExponent) -> Self {
        Self { detector, evidence_exponent, ..self.clone() }
    }

    /// The same model, which knows what look-alikes of its kinds of places reach. Those of images
    /// that are not of its sampling set are refused by [`LookAlikes::new`].
    #[must_use]
    pub fn with_look_alikes(self, look_alikes: LookAlikes) -> Self {
        debug_assert_eq!(look_alikes.shares().len(), self.sampling_set.len(), "one an image");
        Self { look_alikes: Some(look_alikes), ..self }
    }

    /// What look-alikes of each image of the sampling set reach; `None` of models that were trained
    /// before that was learnt, or from words alone.
    #[must_use]
    pub fn look_alikes(&self) -> Option<&LookAlikes> {
        self.look_alikes.as_ref()
    }

    /// What tells of which kind an image is, where look-alikes are known.
    #[must_use]
    pub fn kinds(&self) -> Option<Kinds> {
        let look_alikes = self.look_alikes.as_ref()?;
        Some(Kinds::new(&self.sampling_set, self.vocabulary.len(), look_alikes))
    }

    /// The name of the extractor that the words are made with.
    #[must_use]
    pub fn extractor(&self) -> &str {
        &self.extractor
    }

    /// The visual vocabulary.
    #[must_use]
    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// The Chow-Liu tree.
    #[must_use]
    pub fn tree(&self) -> &ChowLiuTree {
        &self.tree
    }

    /// The detector model.
    #[must_use]
    pub fn detector(&self) -> &DetectorModel {
        &self.detector
    }

    /// What likelihoods are raised to before they are compared.
    #[must_use]
    pub fn evidence_exponent(&self) -> EvidenceExponent {
        self.evidence_exponent
    }

    /// Observations of other places, for the sampled new-place term.
    #[must_use]
    pub fn sampling_set(&self) -> &[Observation] {
        &self.sampling_set
    }

    /// Names the model: hash of all its content.
    #[must_use]
    pub fn hash(&self) -> ContentHash {
        ContentHash(Sha256::digest(self.payload()).into())
    }

    /// Names extractor and vocabulary alone: words of models with equal words hash mean the same.
    #[must_use]
    pub fn words_hash(&self) -> ContentHash {
        let mut writer = Writer::default();
        self.encode_words(&mut writer);
        ContentHash(Sha256::digest(writer.into_bytes()).into())
    }

    /// The model as a file.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let exponent = self.evidence_exponent != EvidenceExponent::NONE;
        let container = match (&self.look_alikes, exponent) {
            (Some(_), _) => CONTAINER,
            (None, true) => WITHOUT_LOOK_ALIKES,
            (None, false) => WITHOUT_EXPONENT,
        };
        container.seal(&self.payload())
    }

    /// Reads a model file.
    ///
    /// # Errors
    /// [`DecodeError`] if it is not one, is newer than this program, cut, damaged or inconsistent.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        let (version, payload) = CONTAINER.open(bytes)?;
        let mut reader = Reader::new(payload);
        let extractor = reader.str()?.to_owned();
        let vocabulary = Vocabulary::decode(&mut reader)?;
        let tree = ChowLiuTree::decode(&mut reader)?;
        let detector = DetectorModel::new(reader.f64()?, reader.f64()?).map_err(DecodeError::invalid)?;
        let samples = reader.count(1)?;
        let sampling_set = (0..samples)
            .map(|_| Observation::decode(&mut reader, vocabulary.len()))
            .collect::<Result<Vec<_>, _>>()?;
        let evidence_exponent = match version {
            0 | 1 => EvidenceExponent::NONE,
            _ => EvidenceExponent::new(reader.f64()?).map_err(DecodeError::invalid)?,
        };
        let look_alikes = match version {
            0..=2 => None,
            _ => Some(decode_look_alikes(&mut reader, samples)?),
        };
        reader.end()?;
        let model = Self::new(extractor, vocabulary, tree, detector, sampling_set);
        let model = model.map_err(DecodeError::invalid)?.recalibrated(detector, evidence_exponent);
        Ok(Self { look_alikes, ..model })
    }

    fn payload(&self) -> Vec<u8> {
        let Self {
            extractor: _,
            vocabulary: _,
            tree,
            detector,
            sampling_set,
            evidence_exponent,
            look_alikes,
        } = self;
        let mut writer = Writer::default();
        self.encode_words(&mut writer);
        tree.encode(&mut writer);
        writer.f64(detector.probability(true, true));
        writer.f64(detector.probability(true, false));
        writer.varint(sampling_set.len() as u64);
        sampling_set.iter().for_each(|sample| sample.encode(&mut writer));
        if *evidence_exponent != EvidenceExponent::NONE || look_alikes.is_some() {
            writer.f64(evidence_exponent.value());
        }
        if let Some(look_alikes) = look_alikes {
            writer.f64(look_alikes.usual_likeness());
            look_alikes.shares().iter().for_each(|share| writer.u32(share.to_bits()));
        }
        writer.into_bytes()
    }

    fn encode_words(&self, writer: &mut Writer) {
        writer.str(&self.extractor);
        self.vocabulary.encode(writer);
    }
}

fn decode_look_alikes(reader: &mut Reader<'_>, images: usize) -> Result<LookAlikes, DecodeError> {
    let usual_likeness = reader.f64()?;
    let shares =
        (0..images).map(|_| Ok(f32::from_bits(reader.u32()?))).collect::<Result<_, DecodeError>>()?;
    LookAlikes::from_parts(shares, usual_likeness, images).map_err(DecodeError::invalid)
}

impl ContentHash {
    /// Its 32 bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Takes 32 bytes as a hash.
    #[must_use]
    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }
}

impl fmt::Display for ContentHash {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(formatter, "{byte:02x}"))
    }
}

impl fmt::Debug for ContentHash {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "ContentHash({self})")
    }
}

/// Text that is not a hash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a hash is written as 64 hexadecimal digits")]
pub struct ParseHashError;

impl FromStr for ContentHash {
    type Err = ParseHashError;

    fn from_str(text: &str) -> Result<Self, ParseHashError> {
        let digits: Option<Vec<u8>> =
            text.chars().map(|digit| digit.to_digit(16).map(|value| value as u8)).collect();
        let bytes: Vec<u8> = digits
            .ok_or(ParseHashError)?
            .chunks(2)
            .map(|pair| pair.iter().fold(0, |byte, d| byte << 4 | d))
            .collect();
        if text.len() != 64 {
            return Err(ParseHashError);
        }
        Ok(Self(bytes.try_into().map_err(|_| ParseHashError)?))
    }
}
