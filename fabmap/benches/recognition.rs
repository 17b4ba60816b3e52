//! One query against a map: the indexed likelihood, the dense one, and the sampled new-place term.
//!
//! `cargo bench -p fabmap --bench recognition`

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use fabmap::appearance::Appearance;
use fabmap::chow_liu::{ChowLiuTree, WordDependence};
use fabmap::detector::DetectorModel;
use fabmap::inverted_index::InvertedIndex;
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::new_place::{NewPlace, NewPlaceMethod, SampleWorkspace};
use fabmap::observation::Observation;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WORDS: u32 = 10_000;
const PLACES: usize = 1_000;
const SAMPLES: usize = 1_000;
const WORDS_PER_IMAGE: usize = 300;

/// Words by a power law, so that some are on most images and most on few.
fn observation(random: &mut ChaCha8Rng) -> Observation {
    let words = (0..WORDS_PER_IMAGE).map(|_| {
        let position: f64 = random.random();
        ((position.powi(3) * f64::from(WORDS)) as u32).min(WORDS - 1)
    });
    let words: Vec<u32> = words.collect();
    Observation::from_words(words, WORDS as usize).unwrap_or_default()
}

fn model(random: &mut ChaCha8Rng) -> ObservationModel {
    let rows = (0..WORDS).map(|word| WordDependence {
        parent: if word == 0 { 0 } else { random.random_range(word / 2..word) },
        marginal: 0.03,
        given_parent_seen: 0.2,
        given_parent_unseen: 0.02,
    });
    let rows: Vec<WordDependence> = rows.collect();
    let Ok(tree) = ChowLiuTree::from_rows(rows) else { unreachable!("parents have lower ids") };
    ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu)
}

fn recognition(criterion: &mut Criterion) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let model = Arc::new(model(&mut random));
    let mut index = InvertedIndex::new(model.clone());
    for _ in 0..PLACES {
        index.add(&Appearance::of(&observation(&mut random)));
    }
    let samples: Vec<Observation> = (0..SAMPLES).map(|_| observation(&mut random)).collect();
    let query = observation(&mut random);
    let place = Appearance::of(&query);
    criterion.bench_function("index, 1,000 places, 10,000 words", |bencher| {
        bencher.iter(|| index.log_likelihoods(black_box(&query)));
    });
    criterion.bench_function("dense, 1 place, 10,000 words", |bencher| {
        bencher.iter(|| model.dense_log_likelihood(black_box(&query), &place));
    });
    let informative = model.informative_words(&query);
    for (name, method) in [("mean", NewPlaceMethod::Sampled), ("tail", NewPlaceMethod::Tail)] {
        if let Ok(new_place) = NewPlace::new(method, &model, &samples) {
            criterion.bench_function(&format!("new place, {name} of 1,000 samples"), |bencher| {
                let mut workspace = SampleWorkspace::default();
                bencher.iter(|| new_place.term(black_box(&informative), PLACES, &mut workspace));
            });
        }
    }
    criterion.bench_function("add a place", |bencher| {
        bencher.iter_batched_ref(
            || index.clone(),
            |index| index.add(&place),
            criterion::BatchSize::LargeInput,
        );
    });
}

criterion_group!(benches, recognition);
criterion_main!(benches);
