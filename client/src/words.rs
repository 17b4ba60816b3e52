//! Words made on the robot: the image stays there, and a few kilobytes go to the server.

use fabmap::model::Model;
use waypost_proto::v1;
use waypost_vision::features::{ExtractError, Extractor, Features};

/// Makes words of images with a model, exactly as the server does.
#[derive(Clone, Debug)]
pub struct WordMaker {
    model: Model,
    extractor: Extractor,
    words_hash: String,
}

/// Why a model file or an image cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WordsError {
    /// The file is no model.
    #[error("this is no model file ({0}); download it with `waypost model export`")]
    Model(#[from] fabmap::codec::DecodeError),
    /// The model has an extractor of a newer Waypost.
    #[error("the model's extractor is not known here ({0}); update this client")]
    Extractor(#[from] waypost_vision::features::SettingsError),
    /// The image cannot be read, or has no room for features.
    #[error(transparent)]
    Image(#[from] ExtractError),
    /// The vocabulary has descriptors of another kind than the extractor.
    #[error("the model's vocabulary does not fit its extractor ({0}); train it again")]
    Vocabulary(#[from] fabmap::vocabulary::VocabularyError),
}

impl WordMaker {
    /// Reads a model file, as [`Client::export_model`](crate::Client::export_model) writes it.
    ///
    /// # Errors
    /// [`WordsError::Model`] or [`WordsError::Extractor`].
    pub fn new(model_file: &[u8]) -> Result<Self, WordsError> {
        let model = Model::from_bytes(model_file)?;
        let extractor = Extractor::new(model.extractor().parse()?);
        Ok(Self { words_hash: model.words_hash().to_string(), extractor, model })
    }

    /// The hash of extractor and vocabulary, for [`SessionOptions`](crate::SessionOptions).
    pub fn words_hash(&self) -> &str {
        &self.words_hash
    }

    /// The word and the position of each feature of a JPEG or PNG. Takes tens of milliseconds: call
    /// it on a blocking thread.
    ///
    /// # Errors
    /// [`WordsError::Image`] if the image cannot be read.
    pub fn words(&self, image: &[u8]) -> Result<v1::WordList, WordsError> {
        let (image, Features { keypoints, descriptors }) = self.extractor.extract_encoded(image)?;
        Ok(v1::WordList {
            words: self.model.vocabulary().words(&descriptors)?.into_iter().map(u32::from).collect(),
            x_px: keypoints.iter().map(|keypoint| keypoint.x_px).collect(),
            y_px: keypoints.iter().map(|keypoint| keypoint.y_px).collect(),
            size_px: keypoints.iter().map(|keypoint| keypoint.size_px).collect(),
            angle_rad: keypoints.iter().map(|keypoint| keypoint.angle_rad).collect(),
            image_width_px: image.width(),
            image_height_px: image.height(),
        })
    }

    /// How often each word occurs in a JPEG or PNG. Takes tens of milliseconds: call it on a
    /// blocking thread.
    ///
    /// # Errors
    /// [`WordsError::Image`] if the image cannot be read.
    pub fn histogram(&self, image: &[u8]) -> Result<v1::WordHistogram, WordsError> {
        let (_, Features { keypoints: _, descriptors }) = self.extractor.extract_encoded(image)?;
        let observation = self.model.vocabulary().observe(&descriptors)?;
        let (words, counts) = observation.histogram();
        let counts = if counts.iter().all(|&count| count == 1) { Vec::new() } else { counts };
        Ok(v1::WordHistogram { words, counts })
    }
}
