//! What robots send: made before the clock starts.

use std::path::Path;

use rayon::prelude::*;
use waypost_client::FrameContent;
use waypost_client::words::WordMaker;
use waypost_proto::v1;

use super::WordSource;
use crate::error::EvalError;
use crate::{dataset, files};

/// Frames to be sent, round and round, and which words they are.
pub(super) struct Contents {
    pub(super) frames: Vec<FrameContent>,
    /// Empty for images.
    pub(super) words_hash: String,
}

impl Contents {
    /// The images of a folder as they are.
    pub(super) fn images(folder: &Path) -> Result<Self, EvalError> {
        let paths = dataset::image_files(folder)?;
        let images = paths.iter().map(|path| files::read(path).map(FrameContent::Image));
        Ok(Self { frames: images.collect::<Result<_, _>>()?, words_hash: String::new() })
    }

    /// Words of the model in this file.
    pub(super) fn words(model_file: &Path, source: &WordSource) -> Result<Self, EvalError> {
        let (model, _extractor) = files::read_model(model_file)?;
        let frames = match source {
            WordSource::Images(folder) => words_of_images(model_file, folder)?,
            WordSource::SamplingSet => model.sampling_set().iter().map(histogram).collect(),
        };
        if frames.is_empty() {
            return Err(EvalError::NoSamplingSet { path: model_file.to_owned() });
        }
        Ok(Self { frames, words_hash: model.words_hash().to_string() })
    }

    pub(super) fn bytes_per_frame(&self) -> f64 {
        let bytes: usize = self.frames.iter().map(FrameContent::encoded_len).sum();
        bytes as f64 / self.frames.len() as f64
    }
}

fn words_of_images(model_file: &Path, folder: &Path) -> Result<Vec<FrameContent>, EvalError> {
    let maker = WordMaker::new(&files::read(model_file)?);
    let maker = maker.map_err(|reason| EvalError::Words { path: model_file.to_owned(), reason })?;
    let paths = dataset::image_files(folder)?;
    let words = paths.par_iter().map(|path| {
        let words = maker.words(&files::read(path)?);
        words.map(FrameContent::Words).map_err(|reason| EvalError::Words { path: path.clone(), reason })
    });
    words.collect()
}

/// An observation as a robot sends it.
pub(super) fn histogram(observation: &fabmap::observation::Observation) -> FrameContent {
    let (words, counts) = observation.word_counts().unzip();
    FrameContent::Histogram(v1::WordHistogram { words, counts })
}
