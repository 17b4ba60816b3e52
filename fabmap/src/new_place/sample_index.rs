//! Places of one look each that never change, scored fast: the sampling set.
//!
//! The same sums as in [`crate::inverted_index`]. As every place here has n = 1, a word has k = 0 or
//! 1 and what it says is looked up, not computed.

use crate::likelihood::{ObservationModel, WordState, unseen};
use crate::observation::{Observation, WordId};

/// The sampling set, indexed by word.
#[derive(Clone, Debug)]
pub(super) struct SampleIndex {
    /// ln p(nothing is seen | a place where one look showed nothing).
    nothing_seen: f64,
    /// Per word, for the three states of an informative one; see [`state_index`].
    gains: Vec<[Gain; 3]>,
    blocks: Vec<Block>,
}

/// What an informative word adds to what it says if neither it nor its parent is seen, in nats.
#[derive(Clone, Copy, Debug)]
struct Gain {
    /// To every sample.
    of_all: f64,
    /// To samples that have the word, besides.
    of_samples_with_it: f64,
}

/// Samples whose scores fit the first-level cache together.
#[derive(Clone, Debug)]
struct Block {
    /// Per sample: what its words change if nothing is seen.
    unseen_gain: Vec<f64>,
    /// The samples with word q are `samples[first[q]..first[q + 1]]`, ascending within the block.
    first: Vec<u32>,
    samples: Vec<u16>,
}

const BLOCK_SAMPLES: usize = 2048;

impl SampleIndex {
    pub(super) fn new(model: &ObservationModel, sampling_set: &[Observation]) -> Self {
        let words = 0..model.vocabulary_len() as WordId;
        Self {
            nothing_seen: model.log_likelihood_of_empty_place(&[], 1),
            gains: words.map(|word| INFORMATIVE_STATES.map(|state| gain(model, word, state))).collect(),
            blocks: sampling_set.chunks(BLOCK_SAMPLES).map(|samples| Block::new(model, samples)).collect(),
        }
    }

    /// ln p(Z | L_u) of every sample, in order, from the informative words of Z.
    pub(super) fn log_likelihoods(&self, informative: &[WordState]) -> Vec<f64> {
        let gains: Vec<(WordId, Gain)> = informative
            .iter()
            .map(|state| (state.word, self.gains[state.word as usize][state_index(*state)]))
            .collect();
        let empty_place = self.nothing_seen + gains.iter().map(|(_, gain)| gain.of_all).sum::<f64>();
        let mut scores = Vec::with_capacity(self.blocks.iter().map(|block| block.unseen_gain.len()).sum());
        for block in &self.blocks {
            block.score(empty_place, &gains, &mut scores);
        }
        scores
    }
}

impl Block {
    fn new(model: &ObservationModel, samples: &[Observation]) -> Self {
        let mut samples_with = vec![Vec::new(); model.vocabulary_len()];
        for (sample, observation) in (0..).zip(samples) {
            observation.words().iter().for_each(|&word| samples_with[word as usize].push(sample));
        }
        let hit_gain = |&word: &WordId| hit_gain(model, unseen(word));
        let ends = samples_with.iter().scan(0, |end, samples: &Vec<u16>| {
            *end += samples.len() as u32;
            Some(*end)
        });
        Self {
            unseen_gain: samples.iter().map(|sample| sample.words().iter().map(hit_gain).sum()).collect(),
            first: std::iter::once(0).chain(ends).collect(),
            samples: samples_with.concat(),
        }
    }

    fn score(&self, empty_place: f64, gains: &[(WordId, Gain)], scores: &mut Vec<f64>) {
        // An array of fixed size, indexed modulo that size, needs no bounds checks.
        let mut sums = [0.0; BLOCK_SAMPLES];
        for &(word, gain) in gains {
            let range = self.first[word as usize] as usize..self.first[word as usize + 1] as usize;
            for &sample in &self.samples[range] {
                sums[usize::from(sample) % BLOCK_SAMPLES] += gain.of_samples_with_it;
            }
        }
        scores.extend(self.unseen_gain.iter().zip(sums).map(|(unseen, sum)| empty_place + unseen + sum));
    }
}

/// (z_q, z_pq) of an informative word.
const INFORMATIVE_STATES: [(bool, bool); 3] = [(false, true), (true, false), (true, true)];

/// Its index in [`INFORMATIVE_STATES`].
fn state_index(state: WordState) -> usize {
    2 * usize::from(state.seen) + usize::from(state.parent_seen) - 1
}

fn gain(model: &ObservationModel, word: WordId, (seen, parent_seen): (bool, bool)) -> Gain {
    let state = WordState { word, seen, parent_seen };
    Gain {
        of_all: model.log_term(state, 0, 1) - model.log_term(unseen(word), 0, 1),
        of_samples_with_it: hit_gain(model, state) - hit_gain(model, unseen(word)),
    }
}

/// What it changes that the one look showed the word.
fn hit_gain(model: &ObservationModel, state: WordState) -> f64 {
    model.log_term(state, 1, 1) - model.log_term(state, 0, 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appearance::Appearance;
    use crate::test_worlds::{self, World};
    use proptest::prelude::*;

    fn assert_dense(model: &ObservationModel, samples: &[Observation], queries: &[Observation]) {
        let index = SampleIndex::new(model, samples);
        for z in queries {
            let scores = index.log_likelihoods(&model.informative_words(z));
            assert_eq!(scores.len(), samples.len());
            for (score, sample) in scores.iter().zip(samples) {
                let dense = model.dense_log_likelihood(z, &Appearance::of(sample));
                assert!((score - dense).abs() <= 1e-9 * dense.abs().max(1.0), "{score} {dense}");
            }
        }
    }

    proptest! {
        #[test]
        fn samples_are_scored_as_places_of_one_look(world in test_worlds::worlds(40, 1), queries in test_worlds::observations(40)) {
            let World { model, observations, .. } = world;
            assert_dense(&model, &observations, &queries);
        }
    }

    #[test]
    fn samples_of_several_blocks_keep_their_order() {
        let World { model, observations, .. } = test_worlds::fixed(30, 2 * BLOCK_SAMPLES + 7, 5);
        assert_dense(&model, &observations, &observations[..3]);
    }
}
