//! A model for simulated worlds, from drives in worlds that nothing is reported of.

use std::ops::ControlFlow;

use fabmap::chow_liu::TreeTrainingSettings;
use fabmap::descriptor::Descriptors;
use fabmap::detector::DetectorModel;
use fabmap::model::{Model, ModelTrainingSettings};
use fabmap::vocabulary::VocabularySettings;
use rayon::prelude::*;
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::{Extractor, FeatureSettings};

use super::{MapError, drive};
use crate::commands::calibrate::{DetectorChoice, calibrated};
use crate::error::EvalError;
use crate::progress;

/// What to learn a model from.
#[derive(Clone, Debug, PartialEq)]
pub struct MapTraining {
    /// The features that words are made of.
    pub features: FeatureSettings,
    /// Number of words.
    pub words: u32,
    /// Drives, each in a world of its own.
    pub drives: u32,
}

/// Seed of the first world that models are trained in; those of drives that are reported are lower.
pub const FIRST_TRAINING_SEED: u64 = 1_000_000;

/// Worlds and routes of the training drives, in turn.
const DRIVES: [(NamedWorld, &str); 4] = [
    (NamedWorld::Office, "98m"),
    (NamedWorld::Corridors, "round"),
    (NamedWorld::BooijOffice, "a-to-c"),
    (NamedWorld::Office, "teach"),
];

/// Drives through the training worlds, and learns words, tree and detector from what was seen.
///
/// # Errors
/// [`EvalError`] if a drive does not come to its end, or shows nothing.
pub fn train(training: &MapTraining) -> Result<Model, EvalError> {
    let MapTraining { features, words, drives } = training;
    let extractor = Extractor::new(*features);
    let mut seen: Vec<Descriptors> = Vec::new();
    let bar = progress::bar("training drives", *drives as usize);
    for (number, &(world, name)) in (0..u64::from(*drives)).zip(DRIVES.iter().cycle()) {
        let Some(route) = world.route(name) else { continue };
        let driven = drive::drive(world, &route, FIRST_TRAINING_SEED + number, WheelErrors::NONE)?;
        let descriptors = driven.frames.par_iter().map(|frame| {
            let features = extractor.extract(&frame.image).map_err(MapError::Features)?;
            Ok(features.descriptors)
        });
        seen.extend(descriptors.collect::<Result<Vec<_>, MapError>>()?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let settings = ModelTrainingSettings {
        vocabulary: VocabularySettings { words: *words, ..VocabularySettings::default() },
        tree: TreeTrainingSettings::default(),
        detector: DetectorModel::default(),
    };
    let model = Model::train(&features.to_string(), &seen, &settings, &mut |_| ControlFlow::Continue(()))?;
    Ok(calibrated(&model, DetectorChoice::Learned)?.0)
}
