use super::*;
use crate::test_worlds::{self, World};
use proptest::prelude::*;

proptest! {
    #[test]
    fn the_index_is_the_dense_evaluation(world in test_worlds::worlds(40, 12)) {
        let World { model, appearances, observations } = world;
        let model = Arc::new(model);
        let mut index = InvertedIndex::new(model.clone());
        for appearance in &appearances {
            index.add(appearance);
        }
        for z in &observations {
            for (place, (sparse, appearance)) in index.log_likelihoods(z).iter().zip(&appearances).enumerate() {
                let dense = model.dense_log_likelihood(z, appearance);
                prop_assert!((dense - sparse).abs() <= 1e-9 * dense.abs(), "place {place}: {dense} {sparse}");
            }
        }
    }

    #[test]
    fn looks_one_by_one_give_the_index_of_the_final_counts(
        world in test_worlds::worlds(25, 3), looks in proptest::collection::vec((0..4u32, 0..4usize), 1..60),
    ) {
        let World { model, observations, .. } = world;
        let model = Arc::new(model);
        let mut grown = InvertedIndex::new(model.clone());
        for (place, look) in looks.into_iter().map(|(place, look)| (PlaceId::new(place), look)) {
            let z = &observations[look % observations.len()];
            if place.index() >= grown.len() { grown.add(&Appearance::of(z)); } else { grown.observe(place, z); }
        }
        let mut restored = InvertedIndex::new(model);
        grown.appearances().for_each(|appearance| { restored.add(&appearance); });
        for z in &observations {
            let (a, b) = (grown.log_likelihoods(z), restored.log_likelihoods(z));
            prop_assert!(a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }
}

/// Words of a fifth of the places are heavy; looks take places out of them, and bring new words.
#[test]
fn heavy_words_are_the_dense_evaluation_however_often_places_were_looked_at() {
    let World { model, observations, .. } = test_worlds::fixed(60, 5000, 11);
    let model = Arc::new(model);
    let mut index = InvertedIndex::new(model.clone());
    let mut appearances: Vec<Appearance> = observations.iter().map(Appearance::of).collect();
    appearances.iter().for_each(|appearance| {
        index.add(appearance);
    });
    for round in 0..4 {
        let mut scores = Vec::new();
        for z in &observations[round..round + 3] {
            index.log_likelihoods_into(
                &model.informative_words(z),
                &mut QueryWeights::default(),
                &mut scores,
            );
            for (appearance, score) in appearances.iter().zip(&scores).skip(round).step_by(7) {
                let dense = model.dense_log_likelihood(z, appearance);
                assert!((dense - score).abs() <= 1e-9 * dense.abs(), "round {round}: {dense} {score}");
            }
        }
        assert!(index.appearances().eq(appearances.iter().cloned()));
        let with = |word| {
            let places = PlaceId::all().zip(&appearances).filter(move |(_, place)| place.hits(word) > 0);
            places.map(|(place, _)| place).collect::<Vec<PlaceId>>()
        };
        assert_eq!(index.places_with(WordId::new(9)), with(WordId::new(9)));
        assert_eq!(
            index.postings(),
            appearances.iter().map(|place| place.word_hits().len() as u64).sum::<u64>()
        );
        for place in (round..5000).step_by(2 + round) {
            let look = &observations[(place * 31 + round) % 5000];
            appearances[place].observe(look);
            index.observe(PlaceId::from_index(place), look);
        }
    }
    let mut restored = InvertedIndex::new(model);
    restored.extend(appearances);
    for z in &observations[..20] {
        let (grown, restored) = (index.log_likelihoods(z), restored.log_likelihoods(z));
        assert!(grown.iter().zip(&restored).all(|(grown, restored)| grown.to_bits() == restored.to_bits()));
    }
}

#[test]
fn weights_may_be_used_again_for_another_vocabulary() {
    let mut weights = QueryWeights::default();
    for words in [200, 60, 130] {
        let World { model, observations, .. } = test_worlds::fixed(words, 40, 5);
        let model = Arc::new(model);
        let mut index = InvertedIndex::new(model.clone());
        index.extend(observations.iter().map(Appearance::of));
        for z in &observations {
            let mut scores = Vec::new();
            index.log_likelihoods_into(&model.informative_words(z), &mut weights, &mut scores);
            assert_eq!(scores, index.log_likelihoods(z), "{words} words");
        }
    }
}

#[test]
fn many_blocks_on_any_number_of_threads_give_the_same_bits() {
    let World { model, observations, .. } = test_worlds::fixed(60, 5000, 7);
    let mut index = InvertedIndex::new(Arc::new(model));
    for z in &observations {
        index.add(&Appearance::of(z));
    }
    let scores = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| index.log_likelihoods(&observations[17]))
            .iter()
            .map(|s| s.to_bits())
            .collect::<Vec<_>>()
    };
    assert_eq!(scores(1), scores(3));
    let last =
        index.model().dense_log_likelihood(&observations[17], &index.appearance(PlaceId::new(4999)).unwrap());
    assert!((f64::from_bits(scores(1)[4999]) - last).abs() < 1e-9 * last.abs());
}
