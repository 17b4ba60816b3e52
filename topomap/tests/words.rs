//! What places show in words, and models of such words.

use std::ops::ControlFlow;

use fabmap::chow_liu::{ChowLiuTree, TreeTrainingSettings};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Words of the models here, unless said otherwise.
pub(crate) const WORDS: u32 = 1000;

/// A view of a place: of the about 40 words of its own choice a share is seen, and some others.
pub(crate) fn view_of(place: u64, seen: f64, others: usize, noise: &mut ChaCha8Rng) -> Observation {
    let mut own = ChaCha8Rng::seed_from_u64(place);
    let mut words: Vec<u32> = (0..40).map(|_| own.random_range(0..WORDS)).collect();
    words.retain(|_| noise.random_bool(seen));
    words.extend((0..others).map(|_| noise.random_range(0..WORDS)));
    Observation::from_words(words, WORDS as usize).unwrap()
}

/// A model of so many words that was trained on such views.
pub(crate) fn model_of(training: Vec<Observation>, words: u32) -> Model {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let rows: Vec<u8> = (0..words as usize * 32).map(|_| random.random()).collect();
    let descriptors = Descriptors::new(DescriptorKind::Binary, 32, rows).unwrap();
    let settings = VocabularySettings { words, seed: 1, iterations: 1 };
    let vocabulary = Vocabulary::train(&descriptors, &settings, &mut |_| ControlFlow::Continue(())).unwrap();
    let tree = ChowLiuTree::train(&training, words as usize, TreeTrainingSettings::default(), &mut |_| {
        ControlFlow::Continue(())
    });
    Model::new("test".to_owned(), vocabulary, tree.unwrap(), DetectorModel::default(), training).unwrap()
}
