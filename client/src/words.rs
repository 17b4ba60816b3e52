//! Words made on the robot: the image stays there, a few kilobytes go to the server.

use fabmap::model::Model;
use waypost_proto::v1;
use waypost_vision::features::{ExtractError, Extractor, Features};

/// Makes words of images as the server would, by the same model.
#[derive(Clone, Debug)]
pub struct WordMaker {
    model: Model,
    extractor: Extractor,
    words_hash: String,
}

/// Why an image gave no words, or a file no maker of them.
#[derive(Debug, thiserror::Error)]
pub enum WordsError {
    /// The file is no model.
    #[error("this is no model file ({0}); download it with `waypost model export`")]
    Model(#[from] fabmap::codec::DecodeError),
    /// The model's features are of a newer Waypost.
    #[error("the model's extractor is not known here ({0}); update this client")]
    Extractor(#[from] waypost_vision::features::SettingsError),
    /// The image cannot be read, or has no room for features.
    #[error(transparent)]
    Image(#[from] ExtractError),
    /// The vocabulary is not of the features that the extractor makes.
    #[error("the model's vocabulary does not fit its extractor ({0}); train it anew")]
    Vocabulary(#[from] fabmap::vocabulary::VocabularyError),
}

impl WordMaker {
    /// From the bytes of a model file, as [`Client::export_model`](crate::Client::export_model) gives them.
    ///
    /// # Errors
    /// [`WordsError::Model`] or [`WordsError::Extractor`].
    pub fn new(model_file: &[u8]) -> Result<Self, WordsError> {
        let model = Model::from_bytes(model_file)?;
        let extractor = Extractor::new(model.extractor().parse()?);
        Ok(Self { words_hash: model.words_hash().to_string(), extractor, model })
    }

    /// What the server must be told when a session of words is opened.
    pub fn words_hash(&self) -> &str {
        &self.words_hash
    }

    /// The word of each feature of a JPEG or PNG, and where it is. Takes tens of milliseconds: not for an
    /// async thread.
    ///
    /// # Errors
    /// [`WordsError::Image`] if the image cannot be read.
    pub fn words(&self, image: &[u8]) -> Result<v1::WordList, WordsError> {
        let (image, Features { keypoints, descriptors }) = self.extractor.extract_encoded(image)?;
        Ok(v1::WordList {
            words: self.model.vocabulary().words(&descriptors)?,
            x_px: keypoints.iter().map(|keypoint| keypoint.x_px).collect(),
            y_px: keypoints.iter().map(|keypoint| keypoint.y_px).collect(),
            size_px: keypoints.iter().map(|keypoint| keypoint.size_px).collect(),
            angle_rad: keypoints.iter().map(|keypoint| keypoint.angle_rad).collect(),
            image_width_px: image.width(),
            image_height_px: image.height(),
        })
    }

    /// How often each word is seen in a JPEG or PNG. Takes tens of milliseconds: not for an async thread.
    ///
    /// # Errors
    /// [`WordsError::Image`] if the image cannot be read.
    pub fn histogram(&self, image: &[u8]) -> Result<v1::WordHistogram, WordsError> {
        let (_, Features { keypoints: _, descriptors }) = self.extractor.extract_encoded(image)?;
        let observation = self.model.vocabulary().observe(&descriptors)?;
        let (words, counts): (Vec<u32>, Vec<u32>) = observation.word_counts().unzip();
        let counts = if counts.iter().all(|&count| count == 1) { Vec::new() } else { counts };
        Ok(v1::WordHistogram { words, counts })
    }
}
