//! Random small worlds that property tests share.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::appearance::Appearance;
use crate::chow_liu::{ChowLiuTree, WordDependence};
use crate::detector::DetectorModel;
use crate::likelihood::{Dependence, ObservationModel};
use crate::observation::{Observation, WordId};

#[derive(Clone, Debug)]
pub(crate) struct World {
    pub(crate) model: ObservationModel,
    pub(crate) observations: Vec<Observation>,
    /// Places observed 1 to 20 times each.
    pub(crate) appearances: Vec<Appearance>,
}

/// Any forest over `words` words, any detector, up to `places` places.
pub(crate) fn worlds(words: usize, places: usize) -> impl Strategy<Value = World> {
    let probability = || 0.001..0.999f64;
    // A parent of lower rank in a random order; rank 0 and a tenth of the others are roots.
    let rows = proptest::collection::vec(
        (any::<prop::sample::Index>(), 0..10u8, probability(), probability(), probability()),
        words,
    );
    let order = Just(WordId::first(words).collect::<Vec<_>>()).prop_shuffle();
    let tree = (rows, order).prop_map(move |(rows, order)| {
        let mut tree = vec![None; words];
        for (rank, (parent, root, marginal, seen, unseen)) in rows.into_iter().enumerate() {
            let word = order[rank];
            let parent = if rank == 0 || root == 0 { word } else { order[parent.index(rank)] };
            tree[word.index()] = Some(WordDependence {
                parent,
                marginal,
                given_parent_seen: seen,
                given_parent_unseen: unseen,
            });
        }
        ChowLiuTree::from_rows(tree.into_iter().flatten()).unwrap()
    });
    let detector = (0.05..0.95f64, prop_oneof![Just(0.0), 0.0..0.9f64])
        .prop_map(|(rate, ratio)| DetectorModel::new(rate, rate * ratio).unwrap());
    let dependence = prop_oneof![Just(Dependence::ChowLiu), Just(Dependence::NaiveBayes)];
    let look = proptest::collection::vec(0..words as u32, 0..words);
    let place = proptest::collection::vec(look.clone(), 1..20);
    let observations = proptest::collection::vec(look, 1..5);
    (tree, detector, dependence, observations, proptest::collection::vec(place, 1..=places)).prop_map(
        move |(tree, detector, dependence, observations, places)| {
            let observe = |look: Vec<u32>| Observation::from_words(look, words).unwrap();
            let appearance = |looks: Vec<Vec<u32>>| {
                let mut appearance = Appearance::default();
                looks.into_iter().for_each(|look| appearance.observe(&observe(look)));
                appearance
            };
            World {
                model: ObservationModel::new(&tree, detector, dependence),
                observations: observations.into_iter().map(observe).collect(),
                appearances: places.into_iter().map(appearance).collect(),
            }
        },
    )
}

/// Some observations of `words` words, more than a tail is fitted to at times.
pub(crate) fn observations(words: usize) -> impl Strategy<Value = Vec<Observation>> {
    let look = proptest::collection::vec(0..words as u32, 0..words);
    proptest::collection::vec(look, 1..60).prop_map(move |looks| {
        looks.into_iter().map(|look| Observation::from_words(look, words).unwrap()).collect()
    })
}

/// A chain of `words` words and `count` observations of about a fifth of them.
pub(crate) fn fixed(words: usize, count: usize, seed: u64) -> World {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let tree = ChowLiuTree::from_rows(WordId::first(words).map(|word| WordDependence {
        parent: WordId::new(word.number().saturating_sub(1)),
        marginal: 0.2,
        given_parent_seen: 0.5,
        given_parent_unseen: 0.1,
    }))
    .unwrap();
    let observations: Vec<Observation> = (0..count)
        .map(|_| WordId::first(words).filter(|_| random.random_bool(0.2)).collect::<Vec<_>>())
        .map(|look| Observation::from_words(look, words).unwrap())
        .collect();
    World {
        model: ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu),
        appearances: observations.iter().map(Appearance::of).collect(),
        observations,
    }
}
