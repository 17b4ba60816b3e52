//! What robots see: places in a ring that words tell apart, a small model of such words, and wheels that make no errors.

use std::f64::consts::TAU;
use std::ops::ControlFlow;
use std::sync::LazyLock;

use fabmap::chow_liu::{ChowLiuTree, TreeTrainingSettings};
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::metric::Odometry;
use waypost_client::v1;

/// Words of the model.
pub(super) const WORDS: u32 = 600;

/// Places of the ring that robots drive along.
pub(super) const PLACES: u64 = 40;

/// Words that each place shows of its own.
const OWN_WORDS: usize = 40;

/// Metres from one place to the next: each is a place of its own by wheels, too.
const APART_M: f64 = 1.0;

/// Views that the model is trained of; none is of the ring.
const TRAINED_VIEWS: u64 = 120;

static MODEL: LazyLock<Model> = LazyLock::new(|| {
    let training: Vec<Observation> = (1000..1000 + TRAINED_VIEWS).map(|place| seen(place, place)).collect();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let rows: Vec<u8> = (0..WORDS as usize * 32).map(|_| random.random()).collect();
    let descriptors = Descriptors::new(DescriptorKind::Binary, 32, rows).unwrap();
    let settings = VocabularySettings { words: WORDS, seed: 1, iterations: 1 };
    let vocabulary = Vocabulary::train(&descriptors, &settings, &mut |_| ControlFlow::Continue(())).unwrap();
    let go_on = &mut |_| ControlFlow::Continue(());
    let tree = ChowLiuTree::train(&training, WORDS as usize, TreeTrainingSettings::default(), go_on).unwrap();
    let extractor = "orb features=200 width=320".to_owned();
    Model::new(extractor, vocabulary, tree, DetectorModel::default(), training).unwrap()
});

/// A model of so few words that a map of it is opened at once.
pub(super) fn model() -> &'static Model {
    &MODEL
}

/// A view of a place: four fifths of the words of its own, and some others.
fn seen(place: u64, noise: u64) -> Observation {
    let mut own = ChaCha8Rng::seed_from_u64(place);
    let mut noise = ChaCha8Rng::seed_from_u64(noise);
    let mut words: Vec<u32> = (0..OWN_WORDS).map(|_| own.random_range(0..WORDS)).collect();
    words.retain(|_| noise.random_bool(0.8));
    words.extend((0..6).map(|_| noise.random_range(0..WORDS)));
    Observation::from_words(words, WORDS as usize).unwrap()
}

/// What a robot sees at a place: now and then a wall, by which nothing can be said.
pub(super) fn view(place: u64, noise: u64) -> Observation {
    if noise % 23 == 7 {
        Observation::from_words([3_u32], WORDS as usize).unwrap()
    } else {
        seen(place, noise)
    }
}

/// Counts of words as they are sent.
pub(super) fn histogram(observation: &Observation) -> v1::WordHistogram {
    let (words, counts) = observation.histogram();
    v1::WordHistogram { words, counts }
}

/// Where wheels put a robot that is at a place of the ring: position, and orientation as x, y, z, w.
fn pose(place: u64) -> ([f64; 3], [f64; 4]) {
    let angle = TAU * (place % PLACES) as f64 / PLACES as f64;
    let radius = APART_M * PLACES as f64 / TAU;
    let half = (angle + TAU / 4.0) / 2.0;
    ([radius * angle.cos(), radius * angle.sin(), 0.0], [0.0, 0.0, half.sin(), half.cos()])
}

/// The same as the map keeps it.
pub(super) fn odometry(place: u64) -> Odometry {
    let (position, orientation) = pose(place);
    Odometry::new(position, orientation, None).unwrap()
}

/// The same as it is sent.
pub(super) fn odometry_message(place: u64) -> v1::Odometry {
    let ([x, y, z], [i, j, k, w]) = pose(place);
    let pose = v1::Pose {
        position_m: Some(v1::Vector3 { x, y, z }),
        orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
    };
    v1::Odometry { pose: Some(pose), covariance: Vec::new() }
}
