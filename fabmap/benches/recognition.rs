//! The stages of one query against a map, and what it takes to add to the map.
//!
//! `cargo bench -p fabmap --bench recognition`

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use fabmap::PlaceId;
use fabmap::appearance::Appearance;
use fabmap::baselines::{BailOutRisk, DenseScorer};
use fabmap::chow_liu::{ChowLiuTree, WordDependence};
use fabmap::detector::DetectorModel;
use fabmap::inverted_index::{InvertedIndex, QueryWeights};
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::new_place::{NewPlace, NewPlaceMethod, SampleWorkspace};
use fabmap::observation::{Observation, WordId};
use fabmap::place_filter::{FilterSettings, MotionPrior, PlaceDistribution, PlaceFilter};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WORDS: u32 = 10_000;
const PLACES: usize = 10_000;
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
        parent: WordId::new(if word == 0 { 0 } else { random.random_range(word / 2..word) }),
        marginal: 0.03,
        given_parent_seen: 0.2,
        given_parent_unseen: 0.02,
    });
    let rows: Vec<WordDependence> = rows.collect();
    let Ok(tree) = ChowLiuTree::from_rows(rows) else { unreachable!("parents have lower ids") };
    ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu)
}

fn scoring(criterion: &mut Criterion) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let model = Arc::new(model(&mut random));
    let images: Vec<Observation> = (0..PLACES).map(|_| observation(&mut random)).collect();
    let mut index = InvertedIndex::new(model.clone());
    images.iter().for_each(|image| {
        index.add(&Appearance::of(image));
    });
    let query = observation(&mut random);
    let place = Appearance::of(&query);
    criterion.bench_function("informative words", |bencher| {
        bencher.iter(|| model.informative_words(black_box(&query)));
    });
    let informative = model.informative_words(&query);
    let (mut weights, mut scores) = (QueryWeights::default(), Vec::new());
    criterion.bench_function("index, 10,000 places looked at once", |bencher| {
        bencher.iter(|| index.log_likelihoods_into(black_box(&informative), &mut weights, &mut scores));
    });
    criterion.bench_function("add a place", |bencher| {
        bencher.iter_batched_ref(|| index.clone(), |index| index.add(&place), BatchSize::LargeInput);
    });
    criterion.bench_function("look at a place once more", |bencher| {
        bencher.iter_batched_ref(
            || index.clone(),
            |index| index.observe(PlaceId::new(17), &query),
            BatchSize::LargeInput,
        );
    });
    for (place, looks) in (0..).zip((0..PLACES).map(|place| place % 15)) {
        (0..looks).for_each(|_| index.observe(PlaceId::new(place), &images[place as usize]));
    }
    criterion.bench_function("index, 10,000 places looked at 1 to 15 times", |bencher| {
        bencher.iter(|| index.log_likelihoods_into(black_box(&informative), &mut weights, &mut scores));
    });
    let few: Vec<Appearance> = images[..2_000].iter().map(Appearance::of).collect();
    let scorer = DenseScorer::new(model.clone(), &few);
    criterion.bench_function("dense, 2,000 places", |bencher| {
        bencher.iter(|| scorer.log_likelihoods(black_box(&query)));
    });
    criterion.bench_function("bail-out, 2,000 places", |bencher| {
        bencher.iter(|| scorer.bail_out(black_box(&query), BailOutRisk::default()));
    });
}

fn filter(criterion: &mut Criterion) {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let model = Arc::new(model(&mut random));
    let samples: Vec<Observation> = (0..SAMPLES).map(|_| observation(&mut random)).collect();
    let informative = model.informative_words(&observation(&mut random));
    for (name, method) in [("mean", NewPlaceMethod::Sampled), ("tail", NewPlaceMethod::Tail)] {
        if let Ok(new_place) = NewPlace::new(method, &model, &samples) {
            let mut workspace = SampleWorkspace::default();
            criterion.bench_function(&format!("new place, {name} of 1,000 samples"), |bencher| {
                bencher.iter(|| new_place.term(black_box(&informative), PLACES, &mut workspace));
            });
        }
    }
    let log_likelihoods: Vec<f64> = (0..PLACES).map(|_| -900.0 - 300.0 * random.random::<f64>()).collect();
    let Ok(mean_field) = NewPlace::new(NewPlaceMethod::MeanField, &model, &[]) else {
        unreachable!("the mean field needs no samples")
    };
    let term = mean_field.term(&informative, PLACES, &mut SampleWorkspace::default());
    let Ok(filter) = PlaceFilter::new(FilterSettings::default()) else {
        unreachable!("the defaults are in range")
    };
    let prior = filter.prior(&MotionPrior::even(), PLACES);
    let mut posterior = PlaceDistribution::default();
    criterion.bench_function("posterior of 10,000 places", |bencher| {
        bencher.iter(|| filter.update_into(black_box(&log_likelihoods), &term, &prior, &mut posterior));
    });
    criterion.bench_function("top ten of 10,000 places", |bencher| {
        bencher.iter(|| black_box(&posterior).top(10));
    });
}

criterion_group!(benches, scoring, filter);
criterion_main!(benches);
