//! How reliable words are, learnt from a model's own samples.
#![expect(clippy::unwrap_used, reason = "a test's own inputs are valid")]

use std::ops::ControlFlow;

use fabmap::calibration::{Calibration, EvidenceExponent, LearnError, Rates, learn};
use fabmap::chow_liu::{ChowLiuTree, TreeTrainingSettings};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WORDS: usize = 400;

/// Samples of a walk: every place has its elements and is seen twice in a row; an element that
/// exists is seen at a rate of the image's own, one of `rates`, and any other word at 0.01.
fn model(places: usize, rates: [f64; 2]) -> Model {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let mut samples = Vec::new();
    for _ in 0..places {
        let elements: Vec<bool> = (0..WORDS).map(|_| random.random_bool(0.2)).collect();
        for _ in 0..2 {
            let rate = rates[usize::from(random.random_bool(0.5))];
            let seen = |&word: &u32| random.random_bool(if elements[word as usize] { rate } else { 0.01 });
            let words: Vec<u32> = (0..WORDS as u32).filter(seen).collect();
            samples.push(Observation::from_words(words, WORDS).unwrap());
        }
    }
    model_of(samples)
}

fn model_of(samples: Vec<Observation>) -> Model {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let bytes = (0..WORDS * 16).map(|_| random.random()).collect();
    let descriptors = Descriptors::new(DescriptorKind::Float, 16, bytes).unwrap();
    let settings = VocabularySettings { words: WORDS as u32, seed: 1, ..VocabularySettings::default() };
    let vocabulary = Vocabulary::train(&descriptors, &settings, &mut |_| ControlFlow::Continue(())).unwrap();
    let tree = ChowLiuTree::train(&samples, WORDS, TreeTrainingSettings::default(), &mut |_| {
        ControlFlow::Continue(())
    });
    Model::new("test".to_owned(), vocabulary, tree.unwrap(), DetectorModel::default(), samples).unwrap()
}

fn learnt(model: &Model, rates: Rates) -> Calibration {
    learn(model, rates, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// Where some images are blurred, their words miss together, which neither detector nor tree
/// expects: each word that is missing says less.
#[test]
fn words_that_depend_on_each_other_count_for_less() {
    let exponent = |rates| learnt(&model(150, rates), Rates::Fixed(DetectorModel::default())).exponent;
    let (alike, blurred) = (exponent([0.5, 0.5]), exponent([0.15, 0.85]));
    assert!(blurred < alike, "{alike:?} {blurred:?}");
}

#[test]
fn learnt_rates_are_no_worse_than_fixed_ones_and_follow_the_words() {
    let unreliable = model(150, [0.25, 0.25]);
    let reliable = model(150, [0.9, 0.9]);
    let rate = |model: &Model| {
        let free = learnt(model, Rates::Learned);
        assert!(free.loss_nats <= learnt(model, Rates::Fixed(DetectorModel::default())).loss_nats);
        free.detector.probability(true, true)
    };
    assert!(rate(&unreliable) < rate(&reliable));
}

#[test]
fn the_same_samples_teach_the_same_on_any_number_of_threads() {
    let model = model(80, [0.5, 0.5]);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let Calibration { exponent, loss_nats, .. } = pool.install(|| learnt(&model, Rates::Learned));
        (exponent.value().to_bits(), loss_nats.to_bits())
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn images_that_do_not_overlap_teach_nothing() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let apart = (0..120).map(|_| {
        let words = (0..WORDS as u32).filter(|_| random.random_bool(0.1)).collect::<Vec<_>>();
        Observation::from_words(words, WORDS).unwrap()
    });
    let model = model_of(apart.collect());
    let refused = learn(&model, Rates::Learned, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert!(matches!(refused, LearnError::TooFewPairs { found } if found < 20), "{refused}");
}

#[test]
fn learning_can_be_cancelled() {
    let cancelled = learn(&model(80, [0.5, 0.5]), Rates::Learned, &mut |_| ControlFlow::Break(()));
    assert_eq!(cancelled, Err(LearnError::Cancelled));
    assert_eq!(EvidenceExponent::NONE.value(), 1.0);
}
