#![doc = include_str!("../README.md")]

pub mod appearance;
pub mod baselines;
pub mod calibration;
pub mod chow_liu;
pub mod codec;
pub mod descriptor;
pub mod detector;
mod evidence_exponent;
pub mod explanation;
mod ids;
pub mod inverted_index;
pub mod likelihood;
pub mod likeness;
pub mod look_alikes;
pub mod model;
pub mod new_place;
pub mod observation;
pub mod place_filter;
mod quantizer;
mod recognition;
pub mod recognizer;
mod slices;
pub mod vocabulary;

#[cfg(test)]
mod test_worlds;

pub use appearance::{Appearance, PlaceId};
pub use calibration::EvidenceExponent;
pub use chow_liu::{ChowLiuTree, TreeTrainingSettings};
pub use descriptor::{DescriptorKind, Descriptors};
pub use detector::DetectorModel;
pub use explanation::{Explanation, WordEvidence};
pub use inverted_index::InvertedIndex;
pub use likelihood::{Dependence, ObservationModel};
pub use look_alikes::{Kind, Kinds, LookAlikes};
pub use model::{Model, ModelTrainingSettings};
pub use new_place::NewPlaceMethod;
pub use observation::{Observation, ObservationError, WordId};
pub use place_filter::{Belief, FilterSettings, MotionPrior, PlaceDistribution, PlaceFilter};
pub use recognizer::{Association, Recognition, Recognizer, RecognizerSettings};
pub use vocabulary::{Vocabulary, VocabularySettings};
