//! What robots send: made before the clock starts.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use rayon::prelude::*;
use waypost_client::FrameContent;
use waypost_client::words::WordMaker;
use waypost_proto::v1;

use crate::{dataset, files};

/// Where robots take their words from.
#[derive(Args)]
#[group(required = true)]
pub(super) struct WordSource {
    /// Folder of JPEG or PNG images that words are made of beforehand.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Words of the model's sampling set, so that no images are needed.
    #[arg(long, conflicts_with = "images")]
    synthetic: bool,
}

/// Frames to be sent, round and round, and which words they are.
pub(super) struct Contents {
    pub(super) frames: Vec<FrameContent>,
    /// Empty for images.
    pub(super) words_hash: String,
}

impl Contents {
    /// The images of a folder as they are.
    pub(super) fn images(folder: &Path) -> Result<Self> {
        let paths = dataset::image_files(folder)?;
        let images = paths.iter().map(|path| files::read(path).map(FrameContent::Image));
        Ok(Self { frames: images.collect::<Result<_, _>>()?, words_hash: String::new() })
    }

    /// Words of the model in this file.
    pub(super) fn words(model_file: &Path, source: &WordSource) -> Result<Self> {
        let (model, _extractor) = files::read_model(model_file)?;
        let frames: Vec<FrameContent> = match &source.images {
            Some(folder) => words_of_images(model_file, folder)?,
            None => model.sampling_set().iter().map(histogram).collect(),
        };
        ensure!(
            !frames.is_empty(),
            "{}: the model remembers no training image; give --images in place of --synthetic",
            model_file.display()
        );
        Ok(Self { frames, words_hash: model.words_hash().to_string() })
    }

    pub(super) fn bytes_per_frame(&self) -> f64 {
        let bytes: usize = self.frames.iter().map(FrameContent::encoded_len).sum();
        bytes as f64 / self.frames.len() as f64
    }
}

fn words_of_images(model_file: &Path, folder: &Path) -> Result<Vec<FrameContent>> {
    let at = |path: &Path| path.display().to_string();
    let maker = WordMaker::new(&files::read(model_file)?).with_context(|| at(model_file))?;
    let paths = dataset::image_files(folder)?;
    let words = paths.par_iter().map(|path| {
        let words = maker.words(&files::read(path)?).with_context(|| at(path))?;
        Ok(FrameContent::Words(words))
    });
    words.collect()
}

/// An observation as a robot sends it.
pub(in crate::commands) fn histogram(observation: &fabmap::observation::Observation) -> FrameContent {
    let (words, counts) = observation.histogram();
    FrameContent::Histogram(v1::WordHistogram { words, counts })
}
