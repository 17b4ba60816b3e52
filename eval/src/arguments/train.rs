//! `waypost-eval train`.

use std::path::PathBuf;

use clap::Args;
use fabmap::vocabulary::VocabularySettings;
use waypost_eval::choices::{DETECTORS, name_of};
use waypost_eval::commands::calibrate::DetectorChoice;
use waypost_eval::commands::train::{self, TrainOptions, VocabularySource};
use waypost_eval::error::EvalError;
use waypost_vision::features::{Feature, FeatureSettings};

use crate::arguments::values::{choice, features};
use crate::{print_if, refuse};

/// Train a model (vocabulary, Chow-Liu tree, sampling set) from folders of images.
#[derive(Args)]
pub(crate) struct TrainArguments {
    /// Folders of JPEG or PNG images, or folders with a subfolder images/ of them.
    #[arg(long, required = true, num_args = 1.., value_name = "DIR")]
    images: Vec<PathBuf>,
    /// The local feature that words are made of.
    #[arg(long, default_value = FeatureSettings::default().feature().name(), value_parser = features())]
    feature: Feature,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "N", default_value_t = VocabularySettings::default().words)]
    words: u32,
    /// Seed of the random choices; the same images and seed give the same model.
    #[arg(long, value_name = "S", default_value_t = VocabularySettings::default().seed)]
    seed: u64,
    /// Take the words from an ORB vocabulary as text (ORBvoc.txt, as DBoW2 writes it) instead of the
    /// images; needs --feature orb.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["words", "seed"])]
    orb_vocabulary: Option<PathBuf>,
    /// How reliable words are: published rates, those with an exponent learnt that tempers likelihoods, or
    /// rates and exponent learnt from images that overlap the one before.
    #[arg(long, value_parser = choice(DETECTORS), default_value = name_of(DETECTORS, &DetectorChoice::default()))]
    detector: DetectorChoice,
    /// The model file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Most features taken from an image.
    #[arg(long, value_name = "N", default_value_t = FeatureSettings::default().max_features())]
    max_features: u32,
    /// Width that larger images are shrunk to, in pixels.
    #[arg(long, value_name = "PX", default_value_t = FeatureSettings::default().image_width())]
    image_width: u32,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl TrainArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self {
            images,
            feature,
            words,
            seed,
            orb_vocabulary,
            detector,
            out,
            max_features,
            image_width,
            json,
        } = self;
        let features =
            FeatureSettings::new(feature, max_features, image_width).map_err(EvalError::FeatureSettings)?;
        let vocabulary = match orb_vocabulary {
            Some(_) if feature != Feature::Orb => {
                refuse("an ORB vocabulary has words of ORB; add --feature orb")
            }
            Some(path) => VocabularySource::OrbText(path),
            None => {
                VocabularySource::Images(VocabularySettings { words, seed, ..VocabularySettings::default() })
            }
        };
        let report = train::run(&TrainOptions { images, features, vocabulary, detector, out })?;
        print_if(json, &report)
    }
}
