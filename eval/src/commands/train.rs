//! `waypost-eval train`: a model from folders of images.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use fabmap::chow_liu::TreeTrainingSettings;
use fabmap::descriptor::Descriptors;
use fabmap::detector::DetectorModel;
use fabmap::model::{Model, ModelTrainingProgress, ModelTrainingSettings, TrainingStage};
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde::Serialize;
use waypost_vision::features::{ExtractError, Extractor, FeatureSettings};

use crate::commands::calibrate::{self, DetectorChoice};
use crate::dataset;
use crate::error::EvalError;
use crate::{files, progress};

/// What to train, from what.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainOptions {
    /// Folders of images, or folders with a subfolder `images/` of them.
    pub images: Vec<PathBuf>,
    /// The features that words are made of.
    pub features: FeatureSettings,
    /// Where the words come from.
    pub vocabulary: VocabularySource,
    /// Where the detector's rates come from.
    pub detector: DetectorChoice,
    /// The model file to write.
    pub out: PathBuf,
}

/// Where a model's words come from.
#[derive(Clone, Debug, PartialEq)]
pub enum VocabularySource {
    /// Clustered from the training images: number of words, seed and iterations.
    Images(VocabularySettings),
    /// Imported from an ORB vocabulary as text, as DBoW2 writes it; tree and sampling set are still
    /// learnt from the training images.
    OrbText(PathBuf),
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrainReport {
    /// Training images.
    pub images: usize,
    /// Descriptors found in them.
    pub descriptors: usize,
    /// Words of the vocabulary.
    pub words: usize,
    /// How long it took, in seconds.
    pub seconds: TrainSeconds,
    /// p(z=1|e=1).
    pub true_positive_rate: f64,
    /// p(z=1|e=0).
    pub false_positive_rate: f64,
    /// What likelihoods are raised to.
    pub evidence_exponent: f64,
    /// Hash of the model's content, its name.
    pub model_hash: String,
    /// Size of the model file.
    pub bytes: usize,
}

/// How long training took, in seconds of wall time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrainSeconds {
    /// Decoding images and extracting features.
    pub extract: f64,
    /// Vocabulary, quantization, tree and detector.
    pub train: f64,
}

/// Trains a model and writes it.
///
/// # Errors
/// [`EvalError`]; no file is written then.
pub fn run(options: &TrainOptions) -> Result<TrainReport, EvalError> {
    let TrainOptions { images, features, vocabulary, detector, out } = options;
    let began = Instant::now();
    let mut paths = Vec::new();
    for folder in images {
        paths.extend(dataset::image_files(folder)?);
    }
    let descriptors = extract_all(&paths, Extractor::new(*features))?;
    let extracted = Instant::now();
    let model = train(*features, vocabulary, &descriptors)?;
    let (model, _) = calibrate::calibrated(&model, *detector)?;
    let trained = Instant::now();
    let bytes = model.to_bytes();
    files::write(out, &bytes)?;
    let report = TrainReport {
        images: paths.len(),
        descriptors: descriptors.iter().map(Descriptors::len).sum(),
        words: model.vocabulary().len(),
        seconds: TrainSeconds {
            extract: extracted.duration_since(began).as_secs_f64(),
            train: trained.duration_since(extracted).as_secs_f64(),
        },
        true_positive_rate: model.detector().probability(true, true),
        false_positive_rate: model.detector().probability(true, false),
        evidence_exponent: model.evidence_exponent().value(),
        model_hash: model.hash().to_string(),
        bytes: bytes.len(),
    };
    eprint!("{}", table(&report, *features, out));
    Ok(report)
}

/// The descriptors of each image, in order of the paths; one image per thread.
pub(crate) fn extract_all(paths: &[PathBuf], extractor: Extractor) -> Result<Vec<Descriptors>, EvalError> {
    let bar = progress::bar("features", paths.len());
    let extracted: Result<Vec<Descriptors>, EvalError> = paths
        .par_iter()
        .map(|path| {
            let descriptors = extract(path, extractor);
            bar.inc(1);
            descriptors
        })
        .collect();
    bar.finish_and_clear();
    extracted
}

fn extract(path: &Path, extractor: Extractor) -> Result<Descriptors, EvalError> {
    let unusable = |reason: ExtractError| EvalError::Image { path: path.to_owned(), reason };
    let (_image, features) = extractor.extract_encoded(&files::read(path)?).map_err(unusable)?;
    Ok(features.descriptors)
}

fn train(
    features: FeatureSettings,
    vocabulary: &VocabularySource,
    descriptors: &[Descriptors],
) -> Result<Model, EvalError> {
    let (tree, detector) = (TreeTrainingSettings::default(), DetectorModel::default());
    let extractor = features.to_string();
    let bar = progress::bar("", PER_MILLE);
    let mut observer = |progress| show(progress, &bar);
    let model = match vocabulary {
        VocabularySource::Images(vocabulary) => {
            let settings = ModelTrainingSettings { vocabulary: vocabulary.clone(), tree, detector };
            Model::train(&extractor, descriptors, &settings, &mut observer)
        }
        VocabularySource::OrbText(path) => {
            let vocabulary = orb_vocabulary(path)?;
            Model::train_over(vocabulary, &extractor, descriptors, tree, detector, &mut observer)
        }
    };
    bar.finish_and_clear();
    Ok(model?)
}

fn orb_vocabulary(path: &Path) -> Result<Vocabulary, EvalError> {
    let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
    Vocabulary::from_orb_text(&text)
        .map_err(|reason| EvalError::OrbVocabulary { path: path.to_owned(), reason })
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

fn table(report: &TrainReport, features: FeatureSettings, out: &Path) -> String {
    let TrainReport {
        images,
        descriptors,
        words,
        seconds,
        true_positive_rate,
        false_positive_rate,
        evidence_exponent,
        model_hash,
        bytes,
    } = report;
    let TrainSeconds { extract, train } = seconds;
    format!(
        "model        {model_hash}\n\
         file         {out} ({bytes} bytes)\n\
         features     {features}\n\
         images       {images}\n\
         descriptors  {descriptors}\n\
         words        {words}\n\
         detector     p(z=1|e=1) {true_positive_rate}, p(z=1|e=0) {false_positive_rate}, exponent {evidence_exponent:.4}\n\
         time         {extract:.1} s features, {train:.1} s training\n",
        out = out.display(),
    )
}
