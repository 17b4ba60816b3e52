//! The inverted index: the same likelihoods as the dense evaluation, from the words that matter.
//!
//! A belief depends on a word, its k and the place's n alone, and the tree couples words of the
//! query only. So a place enters through the words it has:
//!
//! ln p(Z | L_i) = C_n(Z) + Σ_{q: k_q > 0} [f_q(z_q, z_pq; k_q, n) - f_q(z_q, z_pq; 0, n)]
//!
//! where f is [`ObservationModel::log_term`] and C_n the likelihood of a place where n looks showed
//! nothing. The sum is split once more: what the place's words say if the query shows neither
//! word nor parent is kept per place, and a query adds corrections for its informative words.

use std::sync::Arc;

use rayon::prelude::*;

use crate::appearance::{Appearance, PlaceId};
use crate::likelihood::{ObservationModel, WordState, unseen};
use crate::observation::{Observation, WordId};

/// Places with their appearances, indexed by word.
///
/// Exact for any number of looks per place, in any tree. Scores are f64 sums in ascending order of
/// words, whatever the number of threads.
#[derive(Clone, Debug)]
pub struct InvertedIndex {
    model: Arc<ObservationModel>,
    places: Vec<Appearance>,
    /// Per place: Σ of [`InvertedIndex::hit_gain`] over its words for a query that shows neither
    /// word nor parent.
    unseen_gain: Vec<f64>,
    postings: Vec<Postings>,
    /// Places per [`LookClass`]; queries compute weights only for classes in use.
    postings_of_class: Vec<u64>,
    places_of_looks: [u64; Appearance::MAX_LOOKS as usize + 1],
}

/// Where one word was seen: places ascending, each with its class.
#[derive(Clone, Debug, Default)]
struct Postings {
    places: Vec<PlaceId>,
    classes: Vec<LookClass>,
}

/// (k, n) with 1 ≤ k ≤ n ≤ 15 as one byte.
type LookClass = u8;

const LOOK_CLASSES: usize = Appearance::MAX_LOOKS as usize * (Appearance::MAX_LOOKS as usize + 1) / 2;

/// Places scored by one task: its accumulators fit the first-level cache.
const BLOCK_PLACES: usize = 2048;

fn look_class(hits: u8, looks: u8) -> LookClass {
    looks * (looks - 1) / 2 + hits - 1
}

fn hits_and_looks() -> impl Iterator<Item = (u8, u8)> {
    (1..=Appearance::MAX_LOOKS).flat_map(|looks| (1..=looks).map(move |hits| (hits, looks)))
}

impl InvertedIndex {
    /// An index without places.
    #[must_use]
    pub fn new(model: Arc<ObservationModel>) -> Self {
        Self {
            postings: vec![Postings::default(); model.vocabulary_len()],
            model,
            places: Vec::new(),
            unseen_gain: Vec::new(),
            postings_of_class: vec![0; LOOK_CLASSES],
            places_of_looks: [0; Appearance::MAX_LOOKS as usize + 1],
        }
    }

    /// ln p(Z | L_i) of every place, in order of place id.
    #[must_use]
    pub fn log_likelihoods(&self, observation: &Observation) -> Vec<f64> {
        self.log_likelihoods_given(&self.model.informative_words(observation))
    }

    /// The same from the informative words of the observation, for who has them:
    /// [`ObservationModel::informative_words`] of this index's model.
    #[must_use]
    pub fn log_likelihoods_given(&self, informative: &[WordState]) -> Vec<f64> {
        let empty_place = self.empty_place_log_likelihoods(informative);
        let corrections = self.corrections(informative);
        let mut scores = vec![0.0; self.places.len()];
        scores.par_chunks_mut(BLOCK_PLACES).enumerate().for_each(|(block, scores)| {
            let first = block * BLOCK_PLACES;
            for (place, score) in (first..).zip(scores.iter_mut()) {
                *score = empty_place[usize::from(self.places[place].looks())] + self.unseen_gain[place];
            }
            for correction in &corrections {
                self.add_correction(correction, first as PlaceId, scores);
            }
        });
        scores
    }

    /// Number of places.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// True if there is no place yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// The observation model in use.
    #[must_use]
    pub fn model(&self) -> &Arc<ObservationModel> {
        &self.model
    }

    /// A place's appearance; `None` if there is no such place.
    #[must_use]
    pub fn appearance(&self, place: PlaceId) -> Option<&Appearance> {
        self.places.get(place as usize)
    }

    /// All appearances in order of place id.
    #[must_use]
    pub fn appearances(&self) -> &[Appearance] {
        &self.places
    }

    /// The places where `word` was seen, ascending; none for a word that does not exist.
    #[must_use]
    pub fn places_with(&self, word: WordId) -> &[PlaceId] {
        self.postings.get(word as usize).map_or(&[], |postings| &postings.places)
    }

    /// Adds a place and returns its id, the next in order.
    ///
    /// # Panics
    /// If the appearance has a word that the model's vocabulary does not have.
    pub fn add(&mut self, appearance: Appearance) -> PlaceId {
        let place = self.places.len() as PlaceId;
        self.places.push(Appearance::default());
        self.unseen_gain.push(0.0);
        self.places_of_looks[0] += 1;
        self.replace(place, appearance);
        place
    }

    /// Takes one more look at `place`: its words' counts change, no other place does.
    ///
    /// # Panics
    /// If there is no such place, or the observation is of another vocabulary.
    pub fn observe(&mut self, place: PlaceId, observation: &Observation) {
        let mut appearance = self.places[place as usize].clone();
        appearance.observe(observation);
        self.replace(place, appearance);
    }

    fn replace(&mut self, place: PlaceId, appearance: Appearance) {
        let before = std::mem::take(&mut self.places[place as usize]);
        for (hits, looks) in before.word_hits().map(|(_, hits)| (hits, before.looks())) {
            self.postings_of_class[usize::from(look_class(hits, looks))] -= 1;
        }
        self.places_of_looks[usize::from(before.looks())] -= 1;
        let looks = appearance.looks();
        self.places_of_looks[usize::from(looks)] += 1;
        let mut unseen_gain = 0.0;
        for (word, hits) in appearance.word_hits() {
            let class = look_class(hits, looks);
            self.postings_of_class[usize::from(class)] += 1;
            self.postings[word as usize].set(place, class);
            unseen_gain += self.hit_gain(unseen(word), hits, looks);
        }
        self.unseen_gain[place as usize] = unseen_gain;
        self.places[place as usize] = appearance;
    }

    /// What it changes that a word was seen in `hits` of `looks` instead of none.
    fn hit_gain(&self, state: WordState, hits: u8, looks: u8) -> f64 {
        self.model.log_term(state, hits, looks) - self.model.log_term(state, 0, looks)
    }

    /// C_n(Z) for every n in use; 0 for the others.
    fn empty_place_log_likelihoods(&self, informative: &[WordState]) -> Vec<f64> {
        (0u8..)
            .zip(self.places_of_looks)
            .map(
                |(looks, places)| {
                    if places == 0 {
                        0.0
                    } else {
                        self.model.log_likelihood_of_empty_place(informative, looks)
                    }
                },
            )
            .collect()
    }

    /// Per informative word that any place has: by how much a query that shows it so differs from
    /// one that shows neither it nor its parent, for every (k, n) in use.
    fn corrections(&self, informative: &[WordState]) -> Vec<Correction> {
        let of_word = |&state: &WordState| {
            let mut weights = [0.0; LOOK_CLASSES];
            for (weight, ((hits, looks), &postings)) in
                weights.iter_mut().zip(hits_and_looks().zip(&self.postings_of_class))
            {
                if postings > 0 {
                    let without = self.hit_gain(unseen(state.word), hits, looks);
                    *weight = self.hit_gain(state, hits, looks) - without;
                }
            }
            Correction { word: state.word, weights }
        };
        let on_places = |state: &&WordState| !self.places_with(state.word).is_empty();
        informative.iter().filter(on_places).map(of_word).collect()
    }

    fn add_correction(&self, correction: &Correction, first_place: PlaceId, scores: &mut [f64]) {
        let Postings { places, classes } = &self.postings[correction.word as usize];
        let from = places.partition_point(|&place| place < first_place);
        for (&place, &class) in places[from..].iter().zip(&classes[from..]) {
            let Some(score) = scores.get_mut((place - first_place) as usize) else { break };
            *score += correction.weights[usize::from(class)];
        }
    }
}

struct Correction {
    word: WordId,
    weights: [f64; LOOK_CLASSES],
}

impl Postings {
    fn set(&mut self, place: PlaceId, class: LookClass) {
        // New places come at the end; a known one is searched for.
        if self.places.last().is_none_or(|&last| last < place) {
            self.places.push(place);
            self.classes.push(class);
            return;
        }
        match self.places.binary_search(&place) {
            Ok(index) => self.classes[index] = class,
            Err(index) => {
                self.places.insert(index, place);
                self.classes.insert(index, class);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_worlds::{self, World};
    use proptest::prelude::*;

    #[test]
    fn classes_number_every_count_once() {
        let classes: Vec<u8> = hits_and_looks().map(|(hits, looks)| look_class(hits, looks)).collect();
        assert_eq!(classes, (0..LOOK_CLASSES as u8).collect::<Vec<_>>());
    }

    proptest! {
        #[test]
        fn the_index_is_the_dense_evaluation(world in test_worlds::worlds(40, 12)) {
            let World { model, appearances, observations } = world;
            let model = Arc::new(model);
            let mut index = InvertedIndex::new(model.clone());
            for appearance in &appearances {
                index.add(appearance.clone());
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
            for (place, look) in looks {
                let z = &observations[look % observations.len()];
                if place as usize >= grown.len() { grown.add(Appearance::of(z)); } else { grown.observe(place, z); }
            }
            let mut restored = InvertedIndex::new(model);
            grown.appearances().iter().for_each(|appearance| { restored.add(appearance.clone()); });
            for z in &observations {
                let (a, b) = (grown.log_likelihoods(z), restored.log_likelihoods(z));
                prop_assert!(a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits()));
            }
        }
    }

    #[test]
    fn many_blocks_on_any_number_of_threads_give_the_same_bits() {
        let World { model, observations, .. } = test_worlds::fixed(60, 5000, 7);
        let mut index = InvertedIndex::new(Arc::new(model));
        for z in &observations {
            index.add(Appearance::of(z));
        }
        let scores = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| index.log_likelihoods(&observations[17]))
                .iter()
                .map(|s| s.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(scores(1), scores(3));
        let last = index.model().dense_log_likelihood(&observations[17], &index.appearances()[4999]);
        assert!((f64::from_bits(scores(1)[4999]) - last).abs() < 1e-9 * last.abs());
    }
}
