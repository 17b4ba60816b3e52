//! Every word of every place, from a matrix of counts.

use std::sync::Arc;

use crate::appearance::Appearance;
use crate::likelihood::{COUNTS, ObservationModel, WordState, count_index, unseen};
use crate::observation::{Observation, WordId};

/// ln p(Z | L_i) of places that do not change, word by word: for each word and place a byte that
/// says how often the one was seen in the looks at the other. Terms are looked up, not computed.
#[derive(Clone, Debug)]
pub struct DenseScorer {
    model: Arc<ObservationModel>,
    places: usize,
    /// By word, then by place: [`count_index`].
    counts: Vec<u8>,
    /// The same of every `sampled_step`th place, so that those are together.
    sampled_counts: Vec<u8>,
    sampled_step: usize,
    /// By word: places that have it.
    places_with: Vec<u32>,
    most_looks: u8,
    /// n of each place.
    looks: Vec<u8>,
    /// Σ over the place's words: what they say if neither they nor their parents are seen, beyond
    /// what they would say of a place without them.
    unseen_gains: Vec<f64>,
    /// By word, then [`count_index`] up to the most looks: the term if neither the word nor its
    /// parent is seen.
    unseen_terms: Vec<f64>,
}

/// Places that are scored to the end to see how much places differ: so many, or fewer of a small
/// map.
const SAMPLED_PLACES: usize = 256;
const FEWEST_PLACES_PER_SAMPLE: usize = 16;

/// Places whose sums stay in the first-level cache.
const BLOCK_PLACES: usize = 4096;

impl DenseScorer {
    /// Takes a byte for each word of each place.
    ///
    /// # Panics
    /// If a place has a word that the model does not know.
    #[must_use]
    pub fn new(model: Arc<ObservationModel>, places: &[Appearance]) -> Self {
        let words = model.vocabulary_len();
        let looks: Vec<u8> = places.iter().map(Appearance::looks).collect();
        let row: Vec<u8> = looks.iter().map(|&looks| count_index(0, looks) as u8).collect();
        let mut counts = row.repeat(words);
        let mut places_with = vec![0; words];
        for (place, appearance) in places.iter().enumerate() {
            for (word, hits) in appearance.word_hits() {
                counts[word.index() * places.len() + place] = count_index(hits, appearance.looks()) as u8;
                places_with[word.index()] += 1;
            }
        }
        let sampled_step = places.len().div_ceil(SAMPLED_PLACES).max(FEWEST_PLACES_PER_SAMPLE);
        let rows = counts.chunks(places.len().max(1));
        let sampled_counts = rows.flat_map(|row| row.iter().step_by(sampled_step)).copied().collect();
        let unseen_gains = places.iter().map(|place| model.unseen_gain(place)).collect();
        let most_looks = looks.iter().copied().max().unwrap_or(0);
        let unseen_terms = WordId::first(words).flat_map(|word| log_terms(&model, unseen(word), most_looks));
        let unseen_terms = unseen_terms.collect();
        Self {
            model,
            places: places.len(),
            counts,
            sampled_counts,
            sampled_step,
            places_with,
            most_looks,
            looks,
            unseen_gains,
            unseen_terms,
        }
    }

    /// ln p(Z | L_i) of every place: a term for each word of the vocabulary.
    #[must_use]
    pub fn log_likelihoods(&self, observation: &Observation) -> Vec<f64> {
        let informative = self.model.informative_words(observation);
        let terms: Vec<f64> =
            informative.iter().flat_map(|&state| log_terms(&self.model, state, self.most_looks)).collect();
        let mut scores = vec![0.0; self.places];
        let mut table = [0.0; 256];
        for (block, scores) in scores.chunks_mut(BLOCK_PLACES).enumerate() {
            let first = block * BLOCK_PLACES;
            let mut informative = informative.iter().zip(terms.chunks(self.counts_in_use())).peekable();
            for (word, unseen) in self.unseen_terms.chunks(self.counts_in_use()).enumerate() {
                let shown = informative.next_if(|(state, _)| state.word.index() == word);
                table[..unseen.len()].copy_from_slice(shown.map_or(unseen, |(_, terms)| terms));
                let counts = &self.counts[word * self.places + first..][..scores.len()];
                for (score, &count) in scores.iter_mut().zip(counts) {
                    *score += table[usize::from(count)];
                }
            }
        }
        scores
    }

    /// The model of the places.
    #[must_use]
    pub fn model(&self) -> &ObservationModel {
        &self.model
    }

    /// Number of places.
    #[must_use]
    pub fn places(&self) -> usize {
        self.places
    }

    /// How many of the places have a word, over all places.
    pub(super) fn share_of_places_with(&self, word: WordId) -> f64 {
        f64::from(self.places_with[word.index()]) / self.places.max(1) as f64
    }

    /// By [`count_index`]: what an informative word adds at a place that showed it k times, beyond
    /// one that never did and beyond what it would add if neither it nor its parent were seen.
    pub(super) fn gains_of_hits(&self, state: WordState) -> [f64; COUNTS] {
        let mut gains = [0.0; COUNTS];
        self.model.gains_over_unseen(state, self.most_looks, &mut gains);
        for looks in 0..=self.most_looks {
            let without = gains[count_index(0, looks)];
            gains[count_index(0, looks)..=count_index(looks, looks)]
                .iter_mut()
                .for_each(|gain| *gain -= without);
        }
        gains
    }

    /// The scores of all places as if none of the informative words were at any of them.
    pub(super) fn scores_of_nothing(&self, informative: &[WordState]) -> Vec<f64> {
        let of_looks: Vec<f64> = (0..=self.most_looks)
            .map(|looks| self.model.log_likelihood_of_empty_place(informative, looks))
            .collect();
        let places = self.looks.iter().zip(&self.unseen_gains);
        places.map(|(&looks, unseen_gain)| of_looks[usize::from(looks)] + unseen_gain).collect()
    }

    /// Adds what a word says to the scores of `places`, ascending. If there are as many as the map
    /// has, they are all of them.
    pub(super) fn add_gains(&self, word: WordId, gains: &[f64; COUNTS], places: &[u32], scores: &mut [f64]) {
        let counts = &self.counts[word.index() * self.places..][..self.places];
        let mut table = [0.0; 256];
        table[..COUNTS].copy_from_slice(gains);
        if places.len() == self.places {
            for (score, &count) in scores.iter_mut().zip(counts) {
                *score += table[usize::from(count)];
            }
        } else {
            for (score, &place) in scores.iter_mut().zip(places) {
                *score += table[usize::from(counts[place as usize])];
            }
        }
    }

    /// Number of places in the sample.
    pub(super) fn sampled_places(&self) -> usize {
        self.places.div_ceil(self.sampled_step)
    }

    /// [`DenseScorer::add_gains`] for the sample.
    pub(super) fn add_gains_of_sample(&self, word: WordId, gains: &[f64; COUNTS], scores: &mut [f64]) {
        let counts = &self.sampled_counts[word.index() * scores.len()..][..scores.len()];
        for (score, &count) in scores.iter_mut().zip(counts) {
            *score += gains[usize::from(count)];
        }
    }

    fn counts_in_use(&self) -> usize {
        count_index(self.most_looks, self.most_looks) + 1
    }
}

/// ln p(z_q | z_pq, L) by [`count_index`].
fn log_terms(model: &ObservationModel, state: WordState, most_looks: u8) -> impl Iterator<Item = f64> {
    let counts = (0..=most_looks).flat_map(|looks| (0..=looks).map(move |hits| (hits, looks)));
    counts.map(move |(hits, looks)| model.log_term(state, hits, looks))
}
