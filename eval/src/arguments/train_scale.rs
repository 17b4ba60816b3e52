//! `waypost-eval train-scale`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use fabmap::vocabulary::VocabularySettings;
use waypost_eval::commands::train_scale::{
    self, DescriptorOptions, TreeScaleOptions, VocabularyScaleOptions,
};
use waypost_eval::error::EvalError;
use waypost_eval::workload::WorkloadSettings;
use waypost_vision::features::{Feature, FeatureSettings};

use crate::arguments::values::features;
use crate::print_if;

/// Measure training and quantization at the size of large models.
#[derive(Args)]
pub(crate) struct TrainScaleArguments {
    #[command(subcommand)]
    part: TrainScalePart,
    /// Print one JSON object on stdout.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum TrainScalePart {
    /// Extract descriptors of images into a file of rows, for `vocabulary`.
    Descriptors {
        /// Folders of JPEG or PNG images, or folders with a subfolder images/ of them.
        #[arg(long, required = true, num_args = 1.., value_name = "DIR")]
        images: Vec<PathBuf>,
        /// The local feature.
        #[arg(long, default_value = Feature::Sift.name(), value_parser = features())]
        feature: Feature,
        /// Most features taken from an image.
        #[arg(long, value_name = "N", default_value_t = FeatureSettings::default().max_features())]
        max_features: u32,
        /// Width that larger images are shrunk to, in pixels.
        #[arg(long, value_name = "PX", default_value_t = FeatureSettings::default().image_width())]
        image_width: u32,
        /// The file to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Train a vocabulary on a file of rows; time it and its quantization, and hold that against comparing
    /// with every word.
    Vocabulary {
        /// File of rows to train on.
        #[arg(long, value_name = "FILE")]
        descriptors: PathBuf,
        /// How many of them, evenly spread [default: all].
        #[arg(long, value_name = "N")]
        count: Option<usize>,
        /// File of rows of other images, to quantize.
        #[arg(long, value_name = "FILE")]
        queries: PathBuf,
        /// The local feature that both files hold.
        #[arg(long, default_value = Feature::Sift.name(), value_parser = features())]
        feature: Feature,
        /// Number of words.
        #[arg(long, value_name = "N")]
        words: u32,
        /// Seed of the random choices.
        #[arg(long, value_name = "S", default_value_t = VocabularySettings::default().seed)]
        seed: u64,
        /// File for the centres of the words, as rows.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Learn a Chow-Liu tree from images of the synthetic workload.
    Tree {
        /// Words of the vocabulary.
        #[arg(long, value_name = "N", default_value_t = 100_000)]
        words: u32,
        /// Images to learn from.
        #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
        images: u32,
        /// Seed of tree and images.
        #[arg(long, value_name = "S", default_value_t = WorkloadSettings::default().seed)]
        seed: u64,
    },
}

impl TrainScaleArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { part, json } = self;
        match part {
            TrainScalePart::Descriptors { images, feature, max_features, image_width, out } => {
                let features = FeatureSettings::new(feature, max_features, image_width)
                    .map_err(EvalError::FeatureSettings)?;
                print_if(json, &train_scale::write_descriptors(&DescriptorOptions { images, features, out })?)
            }
            TrainScalePart::Vocabulary { descriptors, count, queries, feature, words, seed, out } => {
                let vocabulary = VocabularySettings { words, seed, ..VocabularySettings::default() };
                let count = count.unwrap_or(usize::MAX);
                let options =
                    VocabularyScaleOptions { descriptors, count, queries, feature, vocabulary, out };
                print_if(json, &train_scale::train_vocabulary(&options)?)
            }
            TrainScalePart::Tree { words, images, seed } => {
                let workload = WorkloadSettings { words, seed, ..WorkloadSettings::default() };
                print_if(json, &train_scale::train_tree(&TreeScaleOptions { workload, images })?)
            }
        }
    }
}
