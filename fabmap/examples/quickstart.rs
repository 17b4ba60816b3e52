//! A robot drives twice around a block of twenty places. On the first lap every place is new; on
//! the second it is recognised. Words are made up here; `waypost-vision` finds them in images.
//!
//! `cargo run --release -p fabmap --example quickstart`

use std::error::Error;
use std::ops::ControlFlow;
use std::sync::Arc;

use fabmap::{
    Appearance, Association, ChowLiuTree, Dependence, DetectorModel, MotionPrior, Observation,
    ObservationModel, PlaceId, Recognizer, RecognizerSettings, TreeTrainingSettings,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WORDS: u32 = 2_000;
const PLACES: usize = 20;
const TRAINING_IMAGES: usize = 400;

/// Three words that are often seen together, such as the parts of a window.
const WORDS_PER_OBJECT: u32 = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let mut world = World { random: ChaCha8Rng::seed_from_u64(7) };

    // Before the drive: which words are seen together, from images of other places.
    let training: Vec<Observation> = (0..TRAINING_IMAGES)
        .map(|_| {
            let scene = world.scene();
            world.look_at(&scene)
        })
        .collect::<Result<_, _>>()?;
    let never_stop = &mut |_| ControlFlow::Continue(());
    let tree = ChowLiuTree::train(&training, WORDS as usize, TreeTrainingSettings::default(), never_stop)?;
    let model = ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu);

    // The drive: each observation either belongs to a place that is known, or makes a new one.
    let mut recognizer = Recognizer::over(Arc::new(model), &training, RecognizerSettings::default())?;
    let scenes: Vec<Vec<u32>> = (0..PLACES).map(|_| world.scene()).collect();
    for lap in 1..=2 {
        for (number, scene) in scenes.iter().enumerate() {
            let observation = world.look_at(scene)?;
            let recognition = recognizer.recognize(&observation, &MotionPrior::even());
            let posterior = &recognition.posterior;
            match recognition.association() {
                Association::New => {
                    let place = recognizer.add_place(&Appearance::of(&observation));
                    println!(
                        "lap {lap}, scene {number:2}: somewhere new (p = {:.4}), place {place}",
                        posterior.new_place
                    );
                }
                Association::Seen(place) => {
                    println!("lap {lap}, scene {number:2}: place {place} (p = {:.4})", of(posterior, place));
                    recognizer.observe_place(place, &observation);
                }
            }
        }
    }

    // Why: the words that speak for a place and against it, in nats.
    let observation = world.look_at(&scenes[3])?;
    let recognition = recognizer.recognize(&observation, &MotionPrior::even());
    if let Association::Seen(place) = recognition.association()
        && let Some(explanation) = recognizer.explain(&observation, &recognition, place, 3)
    {
        println!("\nWhy place {place}?");
        for evidence in explanation.words_for.iter().chain(&explanation.words_against) {
            let seen = if evidence.seen { "seen" } else { "not seen" };
            println!(
                "  word {:4} is {seen} now, in {} of {} looks before: {:+.2} nats",
                evidence.word, evidence.hits, evidence.looks, evidence.nats
            );
        }
        println!("  all other words: {:+.2} nats", explanation.other_words_nats);
    }
    Ok(())
}

fn of(posterior: &fabmap::PlaceDistribution, place: PlaceId) -> f64 {
    posterior.places[place.index()]
}

/// Scenes made of objects, and a camera that misses some of their words and mistakes others.
struct World {
    random: ChaCha8Rng,
}

impl World {
    /// The words of twenty objects, more often of common ones.
    fn scene(&mut self) -> Vec<u32> {
        let objects = WORDS / WORDS_PER_OBJECT;
        let object = |rank: f64| ((rank.powi(2) * f64::from(objects)) as u32).min(objects - 1);
        let chosen: Vec<u32> = (0..20).map(|_| object(self.random.random())).collect();
        chosen
            .iter()
            .flat_map(|object| (0..WORDS_PER_OBJECT).map(move |part| object * WORDS_PER_OBJECT + part))
            .collect()
    }

    fn look_at(&mut self, scene: &[u32]) -> Result<Observation, fabmap::ObservationError> {
        let mut words: Vec<u32> = scene.iter().copied().filter(|_| self.random.random_bool(0.7)).collect();
        words.extend((0..5).map(|_| self.random.random_range(0..WORDS)));
        Observation::from_words(words, WORDS as usize)
    }
}
