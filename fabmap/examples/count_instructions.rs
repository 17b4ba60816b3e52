//! Twenty filter updates over a fixed map, for callgrind to count: instructions can be compared
//! between commits on a machine where times cannot. `scripts/count-instructions` runs it.

use std::sync::Arc;

use fabmap::appearance::Appearance;
use fabmap::chow_liu::{ChowLiuTree, WordDependence};
use fabmap::detector::DetectorModel;
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::observation::{Observation, WordId};
use fabmap::place_filter::MotionPrior;
use fabmap::recognizer::{Recognition, Recognizer, RecognizerSettings, Workspace};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WORDS: u32 = 10_000;
const PLACES: usize = 5_000;
const SAMPLES: usize = 300;
const UPDATES: usize = 20;

fn main() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let rows = (0..WORDS).map(|word| WordDependence {
        parent: WordId::new(if word == 0 { 0 } else { random.random_range(word / 2..word) }),
        marginal: 0.03,
        given_parent_seen: 0.2,
        given_parent_unseen: 0.02,
    });
    let rows: Vec<WordDependence> = rows.collect();
    let Ok(tree) = ChowLiuTree::from_rows(rows) else { unreachable!("parents have lower ids") };
    let model = ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu);
    let mut image = || {
        let word = |position: f64| ((position.powi(3) * f64::from(WORDS)) as u32).min(WORDS - 1);
        let words: Vec<u32> = (0..300).map(|_| word(random.random())).collect();
        Observation::from_words(words, WORDS as usize).unwrap_or_default()
    };
    let samples: Vec<Observation> = (0..SAMPLES).map(|_| image()).collect();
    let settings = RecognizerSettings::default();
    let Ok(mut recognizer) = Recognizer::over(Arc::new(model), &samples, settings) else {
        unreachable!("the defaults are in range")
    };
    (0..PLACES).for_each(|_| {
        recognizer.add_place(&Appearance::of(&image()));
    });
    let (mut workspace, mut recognition) = (Workspace::default(), Recognition::default());
    for _ in 0..UPDATES {
        filter_update(&recognizer, &image(), &mut workspace, &mut recognition);
    }
    println!("p(new) = {}", recognition.posterior.new_place);
}

/// What is counted, under a name that callgrind is told.
#[inline(never)]
fn filter_update(
    recognizer: &Recognizer,
    observation: &Observation,
    workspace: &mut Workspace,
    recognition: &mut Recognition,
) {
    recognizer.recognize_into(observation, &MotionPrior::even(), &mut (), workspace, recognition);
    std::hint::black_box(recognition.posterior.top(10));
}
