//! A model for drawn words.

use std::ops::ControlFlow;

use anyhow::Result;
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_vision::features::{Feature, FeatureSettings};

use super::{Use, Workload};

/// Images that the model remembers.
const SAMPLES: u32 = 1_000;

impl Workload {
    /// The workload's tree and samples, over words that no descriptor is ever asked for.
    pub(crate) fn model(&self) -> Result<Model> {
        let features = FeatureSettings::new(Feature::Orb, 500, 640)?;
        let &super::WorkloadSettings { words, seed, .. } = &self.settings;
        let mut rows = vec![0; words as usize * 32];
        ChaCha8Rng::seed_from_u64(seed).fill_bytes(&mut rows);
        let descriptors = Descriptors::new(DescriptorKind::Binary, 32, rows)?;
        let settings = VocabularySettings { words, seed, iterations: 1 };
        let vocabulary = Vocabulary::train(&descriptors, &settings, &mut |_| ControlFlow::Continue(()))?;
        let samples = self.images(Use::Training, SAMPLES);
        let tree = self.tree.clone();
        Ok(Model::new(features.to_string(), vocabulary, tree, DetectorModel::default(), samples)?)
    }
}
