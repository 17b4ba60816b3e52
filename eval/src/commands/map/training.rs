//! A model for simulated worlds, from drives in worlds that nothing is reported of.

use std::ops::ControlFlow;
use std::path::Path;

use anyhow::Result;
use fabmap::chow_liu::TreeTrainingSettings;
use fabmap::detector::DetectorModel;
use fabmap::model::{Model, ModelTrainingSettings};
use fabmap::vocabulary::VocabularySettings;
use rayon::prelude::*;
use waypost_sim::drive::IMAGE_SIZE_PX;
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::{Extractor, Feature, FeatureSettings};
use waypost_vision::look_alikes::TrainingImage;

use super::drive;
use crate::commands::train::{DetectorChoice, calibrated, knowing_look_alikes};
use crate::error::refused;
use crate::{files, progress};

/// What to learn a model from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MapTraining {
    /// The features that words are made of.
    pub features: FeatureSettings,
    /// Number of words.
    pub words: u32,
    /// Drives, each in a world of its own.
    pub drives: u32,
}

/// Seed of the first world that models are trained in; those of drives that are reported are lower.
pub(crate) const FIRST_TRAINING_SEED: u64 = 1_000_000;

/// Worlds and routes of the training drives, in turn.
const DRIVES: [(NamedWorld, &str); 4] = [
    (NamedWorld::Office, "98m"),
    (NamedWorld::Corridors, "round"),
    (NamedWorld::BooijOffice, "a-to-c"),
    (NamedWorld::Office, "teach"),
];

impl Default for MapTraining {
    fn default() -> Self {
        // 3,000 words of ORB: features that a small robot has time for.
        let features = FeatureSettings::new(Feature::Orb, 500, IMAGE_SIZE_PX.0);
        Self { features: features.unwrap_or_default(), words: 3_000, drives: 8 }
    }
}

/// Refuses drives of the seeds that models are trained on.
pub(crate) fn check_seeds(first: u64, trials: u32) -> Result<()> {
    if first.saturating_add(u64::from(trials)) > FIRST_TRAINING_SEED {
        return Err(refused(format_args!(
            "seeds from {FIRST_TRAINING_SEED} on are those of the training drives; take lower ones"
        )));
    }
    Ok(())
}

/// The model of this file; without one, what is learnt by default.
pub(crate) fn model_or_default(file: Option<&Path>) -> Result<(Model, Extractor)> {
    match file {
        Some(path) => files::read_model(path),
        None => MapTraining::default().model(None),
    }
}

impl MapTraining {
    /// The trained model with its extractor; the model is kept in the file, if there is to be one.
    pub(crate) fn model(&self, out: Option<&Path>) -> Result<(Model, Extractor)> {
        let model = train(self)?;
        if let Some(out) = out {
            files::write(out, &model.to_bytes())?;
        }
        Ok((model, Extractor::new(self.features)))
    }
}

/// Drives through the training worlds, and learns words, tree and detector from what was seen.
fn train(training: &MapTraining) -> Result<Model> {
    let MapTraining { features, words, drives } = training;
    let extractor = Extractor::new(*features);
    let mut seen: Vec<TrainingImage> = Vec::new();
    let bar = progress::bar("training drives", *drives as usize);
    for (number, &(world, name)) in (0..u64::from(*drives)).zip(DRIVES.iter().cycle()) {
        let Some(route) = world.route(name) else { continue };
        let driven = drive::drive(world, &route, FIRST_TRAINING_SEED + number, WheelErrors::NONE)?;
        let images = driven.frames.par_iter().map(|frame| {
            let size_px = (frame.image.width(), frame.image.height());
            Ok(TrainingImage { size_px, features: extractor.extract(&frame.image)? })
        });
        seen.extend(images.collect::<Result<Vec<_>>>()?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let settings = ModelTrainingSettings {
        vocabulary: VocabularySettings { words: *words, ..VocabularySettings::default() },
        tree: TreeTrainingSettings::default(),
        detector: DetectorModel::default(),
    };
    let model = Model::train(&features.to_string(), &seen, &settings, &mut |_| ControlFlow::Continue(()))?;
    knowing_look_alikes(calibrated(&model, DetectorChoice::Learned)?.0, &seen)
}
