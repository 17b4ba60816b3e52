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

mod block;
mod directory;
mod heavy_words;
mod place_words;
mod posting;
mod prefetch;
mod weights;

pub use weights::QueryWeights;

use std::sync::Arc;

use rayon::prelude::*;

use crate::appearance::{Appearance, PlaceId};
use crate::likelihood::{ObservationModel, WordState};
use crate::observation::{Observation, WordId};
use block::Block;
use posting::BLOCK_PLACES;

/// Blocks that are made side by side of places that came together.
const BLOCKS_AT_A_TIME: usize = 16;

/// Places with their appearances, indexed by word.
///
/// Exact for any number of looks per place, in any tree: every word's weight is within 5e-13 nats.
/// Sums are of integers, so that neither the order in which looks came nor the number of threads
/// changes a bit of them.
#[derive(Clone, Debug)]
pub struct InvertedIndex {
    model: Arc<ObservationModel>,
    /// All but the last are full.
    blocks: Vec<Block>,
    places_of_looks: [u64; Appearance::MAX_LOOKS as usize + 1],
}

impl InvertedIndex {
    /// An index without places.
    #[must_use]
    pub fn new(model: Arc<ObservationModel>) -> Self {
        Self { model, blocks: Vec::new(), places_of_looks: [0; Appearance::MAX_LOOKS as usize + 1] }
    }

    /// ln p(Z | L_i) of every place, in order of place id.
    #[must_use]
    pub fn log_likelihoods(&self, observation: &Observation) -> Vec<f64> {
        let mut scores = Vec::new();
        let informative = self.model.informative_words(observation);
        self.log_likelihoods_into(&informative, &mut QueryWeights::default(), &mut scores);
        scores
    }

    /// [`InvertedIndex::log_likelihoods`] from the informative words of the observation, as
    /// [`ObservationModel::informative_words`] of this index's model gives them. `weights` and
    /// `scores` are overwritten.
    pub fn log_likelihoods_into(
        &self,
        informative: &[WordState],
        weights: &mut QueryWeights,
        scores: &mut Vec<f64>,
    ) {
        let most_looks = (0u8..).zip(self.places_of_looks).filter(|&(_, places)| places > 0).last();
        weights.prepare(&self.model, informative, most_looks.map_or(0, |(looks, _)| looks));
        scores.resize(self.len(), 0.0);
        let weights = &*weights;
        let blocks = self.blocks.par_iter().zip(scores.par_chunks_mut(BLOCK_PLACES));
        blocks.for_each(|(block, scores)| block.score(weights, scores));
    }

    /// Number of places.
    #[must_use]
    pub fn len(&self) -> usize {
        self.blocks.last().map_or(0, |last| (self.blocks.len() - 1) * BLOCK_PLACES + last.len())
    }

    /// True if there is no place yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// The observation model in use.
    #[must_use]
    pub fn model(&self) -> &Arc<ObservationModel> {
        &self.model
    }

    /// A place's appearance; `None` if there is no such place. It is read from the postings.
    #[must_use]
    pub fn appearance(&self, place: PlaceId) -> Option<Appearance> {
        let (block, place) = (place.index() / BLOCK_PLACES, place.index() % BLOCK_PLACES);
        let block = self.blocks.get(block).filter(|block| place < block.len())?;
        Some(block.appearance(place))
    }

    /// All appearances in order of place id.
    pub fn appearances(&self) -> impl Iterator<Item = Appearance> + '_ {
        self.blocks.iter().flat_map(|block| (0..block.len()).map(|place| block.appearance(place)))
    }

    /// The places where `word` was seen, ascending; none for a word that does not exist.
    #[must_use]
    pub fn places_with(&self, word: WordId) -> Vec<PlaceId> {
        let blocks = (0..).step_by(BLOCK_PLACES).zip(&self.blocks);
        blocks
            .flat_map(|(first, block)| {
                block.places_with(word).into_iter().map(move |place| PlaceId::from_index(first + place))
            })
            .collect()
    }

    /// (word, place) pairs that are indexed.
    #[must_use]
    pub fn postings(&self) -> u64 {
        self.blocks.iter().map(|block| block.postings() as u64).sum()
    }

    /// Memory that the index takes for its places: postings, their directory, and what is kept per
    /// place. Without the model, which does not grow.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        self.blocks.capacity() * size_of::<Block>()
            + self.blocks.iter().map(Block::memory_bytes).sum::<usize>()
    }

    /// Adds a place and returns its id, the next in order.
    ///
    /// # Panics
    /// If the appearance has a word that the model's vocabulary does not have.
    pub fn add(&mut self, appearance: &Appearance) -> PlaceId {
        let place = self.push(appearance);
        self.settle();
        place
    }

    /// Adds places in order, whole blocks side by side. Of many it takes a fraction of the time of
    /// adding them one by one.
    ///
    /// # Panics
    /// See [`InvertedIndex::add`].
    pub fn extend(&mut self, appearances: impl IntoIterator<Item = Appearance>) {
        let mut appearances = appearances.into_iter();
        let room = self.blocks.last().map_or(0, |last| BLOCK_PLACES - last.len());
        for appearance in appearances.by_ref().take(room) {
            self.push(&appearance);
        }
        self.settle();
        loop {
            let some: Vec<Appearance> = appearances.by_ref().take(BLOCKS_AT_A_TIME * BLOCK_PLACES).collect();
            if some.is_empty() {
                return;
            }
            some.iter().for_each(|appearance| self.count(appearance));
            let model = &self.model;
            let block = |places: &[Appearance]| {
                let mut block = Block::default();
                places.iter().for_each(|appearance| block.add(model, appearance));
                block.merge(model.vocabulary_len());
                block
            };
            self.blocks.par_extend(some.par_chunks(BLOCK_PLACES).map(block));
        }
    }

    /// Counts a place that is about to be added.
    fn count(&mut self, appearance: &Appearance) {
        let words = self.model.vocabulary_len();
        let last_word = appearance.word_hits().next_back().map(|(word, _)| word);
        assert!(last_word.is_none_or(|word| word.index() < words), "a place of another vocabulary");
        self.places_of_looks[usize::from(appearance.looks())] += 1;
    }

    fn push(&mut self, appearance: &Appearance) -> PlaceId {
        self.count(appearance);
        let place = PlaceId::from_index(self.len());
        let block = match self.blocks.last_mut() {
            Some(last) if !last.is_full() => last,
            Some(_) | None => self.blocks.push_mut(Block::default()),
        };
        block.add(&self.model, appearance);
        place
    }

    fn settle(&mut self) {
        let words = self.model.vocabulary_len();
        if let Some(last) = self.blocks.last_mut() {
            if last.is_full() { last.merge(words) } else { last.settle(words) }
        }
    }

    /// Takes one more look at `place`: its words' counts change, no other place does.
    ///
    /// # Panics
    /// If there is no such place, or the observation is of another vocabulary.
    pub fn observe(&mut self, place: PlaceId, observation: &Observation) {
        let words = self.model.vocabulary_len();
        let last_word = observation.words().last();
        assert!(last_word.is_none_or(|&word| word.index() < words), "a look of another vocabulary");
        let (block, place) = (place.index() / BLOCK_PLACES, place.index() % BLOCK_PLACES);
        let block = &mut self.blocks[block];
        self.places_of_looks[usize::from(block.looks(place))] -= 1;
        block.observe(place, &self.model, observation);
        self.places_of_looks[usize::from(block.looks(place))] += 1;
    }
}

#[cfg(test)]
mod tests;
