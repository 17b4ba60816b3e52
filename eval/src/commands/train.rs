//! `waypost-eval train`: a model from folders of images, or another detector for a model that there is.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use fabmap::calibration::{self, Calibration, EvidenceExponent, LearnError, Rates};
use fabmap::chow_liu::TreeTrainingSettings;
use fabmap::detector::DetectorModel;
use fabmap::model::{Model, ModelTrainingProgress, ModelTrainingSettings, TrainingStage};
use fabmap::vocabulary::VocabularySettings;
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde::Serialize;
use waypost_vision::features::{Extractor, Feature, FeatureSettings};
use waypost_vision::look_alikes::{self, LearnError as LookAlikesError, TrainingImage};

use crate::choices::features;
use crate::dataset;
use crate::error::refused;
use crate::{files, progress, vocabularies};

/// Train a model (vocabulary, Chow-Liu tree, sampling set) from folders of images.
#[derive(Args)]
pub(crate) struct TrainOptions {
    /// Folders of JPEG or PNG images, or folders with a subfolder images/ of them.
    #[arg(long, required_unless_present = "recalibrate", num_args = 1.., value_name = "DIR")]
    images: Vec<PathBuf>,
    /// In place of images, a model file: how reliable its words are is learnt again, from the training images that it
    /// remembers. Words stay the same, so that maps can be bound to the new model.
    #[arg(long, value_name = "FILE",
          conflicts_with_all = ["images", "feature", "words", "seed", "orb_vocabulary", "max_features", "image_width"])]
    recalibrate: Option<PathBuf>,
    /// The local feature that words are made of.
    #[arg(long, default_value = FeatureSettings::default().feature().name(), value_parser = features())]
    feature: Feature,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "N", default_value_t = VocabularySettings::default().words)]
    words: u32,
    /// Seed of the random choices; the same images and seed give the same model.
    #[arg(long, value_name = "S", default_value_t = VocabularySettings::default().seed)]
    seed: u64,
    /// Take the words, with their tree, from an ORB vocabulary instead of the images; needs --feature orb. It may be
    /// ORBvoc.txt, .yml of DBoW2 or DBoW3, or .fbow of FBoW, also packed as .gz.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["words", "seed"])]
    orb_vocabulary: Option<PathBuf>,
    /// How reliable words are: published rates, those with an exponent learnt that tempers likelihoods, or
    /// rates and exponent learnt from images that overlap the one before.
    #[arg(long, value_enum, default_value_t)]
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
}

/// Where the detector's rates come from.
#[derive(Clone, Copy, Default, ValueEnum)]
pub(crate) enum DetectorChoice {
    /// Published rates, with likelihoods as they are. It asks nothing of the training images; the others need
    /// neighbours that overlap.
    Fixed,
    /// Published rates, with the exponent learnt that makes their likelihoods comparable.
    Tempered,
    /// Rates and exponent learnt together; typical ones where too few training images overlap.
    #[default]
    Learned,
}

/// What came out.
#[derive(Serialize)]
pub(crate) struct TrainReport {
    /// Training images; null if the model's words were there.
    images: Option<usize>,
    /// Descriptors found in them.
    descriptors: Option<usize>,
    /// The features that words are made of.
    features: String,
    /// Words of the vocabulary.
    words: usize,
    /// How long it took.
    seconds: TrainSeconds,
    /// p(z=1|e=1).
    true_positive_rate: f64,
    /// p(z=1|e=0).
    false_positive_rate: f64,
    /// What likelihoods are raised to.
    evidence_exponent: f64,
    /// Pairs of overlapping training images that rates and exponent were learnt from; null if nothing was.
    pairs: Option<usize>,
    /// Mean of -ln p(what is right) over staged revisits and new places, in nats.
    loss_nats: Option<f64>,
    /// What the best look-alike shows of an image, per word, in the mean; null if it was not learnt.
    look_alike_share: Option<f64>,
    /// Hash of the model's content, its name.
    model_hash: String,
    /// Size of the model file.
    bytes: usize,
}

/// How long training took, in seconds of wall time.
#[derive(Serialize)]
struct TrainSeconds {
    /// Decoding images and extracting features.
    extract: f64,
    /// Vocabulary, quantization, tree and detector.
    train: f64,
}

/// Trains a model and writes it; if it fails, no file is written.
pub(crate) fn run(options: &TrainOptions) -> Result<TrainReport> {
    let began = Instant::now();
    let (extracted, images, model) = match &options.recalibrate {
        Some(path) => (began, None, files::read_model(path)?.0),
        None => {
            let features = options.features()?;
            let images = extract_all(&options.images, Extractor::new(features))?;
            let extracted = Instant::now();
            let model = options.train(features, &images)?;
            (extracted, Some(images), model)
        }
    };
    let (mut model, learnt) = calibrated(&model, options.detector)?;
    if let Some(images) = &images {
        model = knowing_look_alikes(model, images)?;
    }
    let trained = Instant::now();
    let bytes = model.to_bytes();
    files::write(&options.out, &bytes)?;
    Ok(TrainReport {
        images: images.as_ref().map(Vec::len),
        descriptors: images.map(|images| images.iter().map(|image| image.features.descriptors.len()).sum()),
        features: model.extractor().to_owned(),
        words: model.vocabulary().len(),
        seconds: TrainSeconds {
            extract: extracted.duration_since(began).as_secs_f64(),
            train: trained.duration_since(extracted).as_secs_f64(),
        },
        true_positive_rate: model.detector().probability(true, true),
        false_positive_rate: model.detector().probability(true, false),
        evidence_exponent: model.evidence_exponent().value(),
        pairs: learnt.map(|learnt| learnt.pairs),
        loss_nats: learnt.map(|learnt| learnt.loss_nats),
        look_alike_share: model.look_alikes().map(|known| {
            let shares = known.shares();
            shares.iter().map(|&share| f64::from(share)).sum::<f64>() / shares.len().max(1) as f64
        }),
        model_hash: model.hash().to_string(),
        bytes: bytes.len(),
    })
}

impl TrainOptions {
    /// A model of these images, all else as it is by default.
    pub(crate) fn of_images(images: Vec<PathBuf>, words: u32, seed: u64, out: PathBuf) -> Self {
        let features = FeatureSettings::default();
        Self {
            images,
            recalibrate: None,
            feature: features.feature(),
            words,
            seed,
            orb_vocabulary: None,
            detector: DetectorChoice::default(),
            out,
            max_features: features.max_features(),
            image_width: features.image_width(),
        }
    }

    fn features(&self) -> Result<FeatureSettings> {
        if self.orb_vocabulary.is_some() && self.feature != Feature::Orb {
            return Err(refused("an ORB vocabulary has words of ORB; add --feature orb"));
        }
        FeatureSettings::new(self.feature, self.max_features, self.image_width).map_err(refused)
    }

    fn train(&self, features: FeatureSettings, images: &[TrainingImage]) -> Result<Model> {
        let tree = TreeTrainingSettings::default();
        let detector = DetectorModel::default();
        let extractor = features.to_string();
        let bar = progress::bar("", PER_MILLE);
        let mut observer = |progress| show(progress, &bar);
        let model = match &self.orb_vocabulary {
            None => {
                let vocabulary = VocabularySettings {
                    words: self.words,
                    seed: self.seed,
                    ..VocabularySettings::default()
                };
                let settings = ModelTrainingSettings { vocabulary, tree, detector };
                Model::train(&extractor, images, &settings, &mut observer)
            }
            Some(path) => {
                let vocabulary = vocabularies::read(path)?;
                Model::train_over(vocabulary, &extractor, images, tree, detector, &mut observer)
            }
        };
        bar.finish_and_clear();
        Ok(model?)
    }
}

/// The features of each image of these folders, in order of the paths; one image per thread.
fn extract_all(folders: &[PathBuf], extractor: Extractor) -> Result<Vec<TrainingImage>> {
    let paths =
        folders.iter().map(|folder| dataset::image_files(folder)).collect::<Result<Vec<_>>>()?.concat();
    let bar = progress::bar("features", paths.len());
    let extracted = paths.par_iter().map(|path| {
        let extracted = extractor.extract_encoded(&files::read(path)?);
        let (image, features) = extracted.with_context(|| path.display().to_string())?;
        bar.inc(1);
        Ok(TrainingImage { size_px: (image.width(), image.height()), features })
    });
    let extracted = extracted.collect();
    bar.finish_and_clear();
    extracted
}

/// The model over the same words as `choice` has it, and what was learnt for it. It fails if only the exponent was to
/// be learnt and too few training images overlap.
pub(crate) fn calibrated(model: &Model, choice: DetectorChoice) -> Result<(Model, Option<Calibration>)> {
    let fixed = DetectorModel::default();
    let bar = progress::bar("detector", PER_MILLE);
    let mut observer = |fraction| {
        bar.set_position((fraction * PER_MILLE as f64) as u64);
        ControlFlow::Continue(())
    };
    let calibrated = match choice {
        DetectorChoice::Fixed => (model.recalibrated(fixed, EvidenceExponent::NONE), None),
        DetectorChoice::Tempered => {
            let learnt = calibration::learn(model, Rates::Fixed(fixed), &mut observer)?;
            (model.recalibrated(learnt.detector, learnt.exponent), Some(learnt))
        }
        DetectorChoice::Learned => match calibration::calibrate(model, &mut observer) {
            ControlFlow::Continue(calibrated) => calibrated,
            ControlFlow::Break(()) => return Err(LearnError::Cancelled.into()),
        },
    };
    bar.finish_and_clear();
    Ok(calibrated)
}

/// The same model, which knows what look-alikes of its training images show. If those do not tell, the model does
/// without, and says so.
pub(crate) fn knowing_look_alikes(model: Model, images: &[TrainingImage]) -> Result<Model> {
    let bar = progress::bar("look-alikes", PER_MILLE);
    let mut observer = |fraction| {
        bar.set_position((fraction * PER_MILLE as f64) as u64);
        ControlFlow::Continue(())
    };
    let learnt = look_alikes::learn(&model, images, &mut observer);
    bar.finish_and_clear();
    match learnt {
        Ok(look_alikes) => Ok(model.with_look_alikes(look_alikes)),
        Err(error @ (LookAlikesError::TooFew { .. } | LookAlikesError::NoOrder)) => {
            eprintln!("{error}; without, maps ask for as much evidence as look-alike floors need");
            Ok(model)
        }
        Err(error) => Err(error.into()),
    }
}

/// Steps of the bar of one stage.
const PER_MILLE: usize = 1000;

fn show(progress: ModelTrainingProgress, bar: &ProgressBar) -> ControlFlow<()> {
    let ModelTrainingProgress { stage, fraction } = progress;
    bar.set_message(match stage {
        TrainingStage::Vocabulary => "vocabulary",
        TrainingStage::Quantization => "words",
        TrainingStage::Tree => "Chow-Liu tree",
    });
    bar.set_position((fraction.clamp(0.0, 1.0) * PER_MILLE as f64) as u64);
    ControlFlow::Continue(())
}
