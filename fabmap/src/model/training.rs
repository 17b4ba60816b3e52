//! Training a model from the descriptors of training images.

use std::ops::ControlFlow;

use super::{Model, ModelError};
use crate::chow_liu::{ChowLiuTree, TreeTrainingError, TreeTrainingSettings};
use crate::descriptor::{DescriptorError, Descriptors};
use crate::detector::DetectorModel;
use crate::observation::Observation;
use crate::vocabulary::{Vocabulary, VocabularyError, VocabularySettings};

/// Settings of [`Model::train`].
#[derive(Clone, Debug, PartialEq)]
pub struct ModelTrainingSettings {
    /// Number of words and how they are found.
    pub vocabulary: VocabularySettings,
    /// How the tree is smoothed.
    pub tree: TreeTrainingSettings,
    /// The detector model to store.
    pub detector: DetectorModel,
}

impl ModelTrainingSettings {
    /// Descriptors per word that k-means sees, taken evenly over all images: more cost time and
    /// hardly move a centre.
    pub const DESCRIPTORS_PER_WORD: usize = 50;
    /// Observations kept as the sampling set, taken evenly over all images.
    pub const MAX_SAMPLES: usize = 3000;

    /// The numbers of the images that make the sampling set, of so many.
    pub fn sampled(images: usize) -> impl Iterator<Item = usize> {
        every_nth(images, Self::MAX_SAMPLES)
    }
}

/// What training is busy with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TrainingStage {
    /// Finding the words.
    Vocabulary,
    /// Turning every image into words.
    Quantization,
    /// Learning the tree.
    Tree,
}

/// How far training has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelTrainingProgress {
    /// What is being done.
    pub stage: TrainingStage,
    /// How much of that stage is done, in [0, 1].
    pub fraction: f64,
}

/// Why no model was trained.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelTrainingError {
    /// No image with features.
    #[error("none of {images} training images shows a feature; give textured, well-lit images")]
    NoDescriptors {
        /// Images given.
        images: usize,
    },
    /// Images of different features were mixed.
    #[error(transparent)]
    Descriptors(#[from] DescriptorError),
    /// The vocabulary could not be made.
    #[error(transparent)]
    Vocabulary(VocabularyError),
    /// The tree could not be learnt.
    #[error(transparent)]
    Tree(TreeTrainingError),
    /// The parts do not fit.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The observer asked to stop.
    #[error("training was cancelled")]
    Cancelled,
}

impl From<VocabularyError> for ModelTrainingError {
    fn from(error: VocabularyError) -> Self {
        if error == VocabularyError::Cancelled { Self::Cancelled } else { Self::Vocabulary(error) }
    }
}

impl From<TreeTrainingError> for ModelTrainingError {
    fn from(error: TreeTrainingError) -> Self {
        if error == TreeTrainingError::Cancelled { Self::Cancelled } else { Self::Tree(error) }
    }
}

impl Model {
    /// Vocabulary, tree and sampling set from the descriptors of training images, one set an image.
    /// `extractor` names how they were made. `observer` is called with the progress and may cancel.
    ///
    /// # Errors
    /// [`ModelTrainingError`].
    pub fn train(
        extractor: &str,
        images: &[impl AsRef<Descriptors>],
        settings: &ModelTrainingSettings,
        observer: &mut dyn FnMut(ModelTrainingProgress) -> ControlFlow<()>,
    ) -> Result<Self, ModelTrainingError> {
        let ModelTrainingSettings { vocabulary, tree, detector } = settings;
        let wanted = vocabulary.words as usize * ModelTrainingSettings::DESCRIPTORS_PER_WORD;
        let sample = evenly_taken_descriptors(images, wanted)?;
        let vocabulary = Vocabulary::train(&sample, vocabulary, &mut |progress| {
            observer(ModelTrainingProgress { stage: TrainingStage::Vocabulary, fraction: progress.fraction })
        })?;
        Self::train_over(vocabulary, extractor, images, *tree, *detector, observer)
    }

    /// Tree and sampling set over a vocabulary that is there already, an imported one for example.
    ///
    /// # Errors
    /// [`ModelTrainingError`].
    pub fn train_over(
        vocabulary: Vocabulary,
        extractor: &str,
        images: &[impl AsRef<Descriptors>],
        tree: TreeTrainingSettings,
        detector: DetectorModel,
        observer: &mut dyn FnMut(ModelTrainingProgress) -> ControlFlow<()>,
    ) -> Result<Self, ModelTrainingError> {
        if images.iter().all(|image| image.as_ref().is_empty()) {
            return Err(ModelTrainingError::NoDescriptors { images: images.len() });
        }
        let observations = observe_all(&vocabulary, images, observer)?;
        let tree = ChowLiuTree::train(&observations, vocabulary.len(), tree, &mut |fraction| {
            observer(ModelTrainingProgress { stage: TrainingStage::Tree, fraction })
        })?;
        let sampled = ModelTrainingSettings::sampled(observations.len());
        let sampling_set = sampled.map(|image| observations[image].clone()).collect();
        Ok(Self::new(extractor.to_owned(), vocabulary, tree, detector, sampling_set)?)
    }
}

fn observe_all(
    vocabulary: &Vocabulary,
    images: &[impl AsRef<Descriptors>],
    observer: &mut dyn FnMut(ModelTrainingProgress) -> ControlFlow<()>,
) -> Result<Vec<Observation>, ModelTrainingError> {
    let mut observations = Vec::with_capacity(images.len());
    for (done, image) in images.iter().enumerate() {
        let fraction = done as f64 / images.len() as f64;
        if observer(ModelTrainingProgress { stage: TrainingStage::Quantization, fraction }).is_break() {
            return Err(ModelTrainingError::Cancelled);
        }
        observations.push(vocabulary.observe(image.as_ref())?);
    }
    Ok(observations)
}

/// At most `wanted` descriptors, evenly spaced over all of them in order.
fn evenly_taken_descriptors(
    images: &[impl AsRef<Descriptors>],
    wanted: usize,
) -> Result<Descriptors, ModelTrainingError> {
    let none = ModelTrainingError::NoDescriptors { images: images.len() };
    let described = || images.iter().map(AsRef::as_ref);
    let Some(first) = described().find(|descriptors| !descriptors.is_empty()) else { return Err(none) };
    let mut rows = Vec::new();
    for descriptors in described() {
        first.check_matches(descriptors)?;
        rows.extend(descriptors.rows());
    }
    let taken: Vec<u8> = every_nth(rows.len(), wanted).flat_map(|row| rows[row]).copied().collect();
    Ok(Descriptors::new(first.kind(), first.width(), taken)?)
}

/// At most `wanted` of the numbers below `len`, evenly spread.
fn every_nth(len: usize, wanted: usize) -> impl Iterator<Item = usize> {
    let taken = len.min(wanted);
    (0..taken).map(move |index| (index as u128 * len as u128 / taken as u128) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_spread_over_all() {
        assert_eq!(every_nth(10, 4).collect::<Vec<_>>(), [0, 2, 5, 7]);
        assert_eq!(every_nth(3, 9).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(every_nth(0, 9).count(), 0);
    }
}
