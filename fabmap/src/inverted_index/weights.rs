//! What the informative words of one query add to places that have them.

use crate::appearance::Appearance;
use crate::likelihood::{COUNTS, ObservationModel, WordState, count_index};
use crate::observation::WordId;

/// Nats as integers: sums of them are the same in any order, so that neither the order of postings
/// nor the number of threads can be seen in a score. Within 2^-41 of the exact value, that is 5e-13
/// nats a word; sums of up to 8 million nats.
pub(super) type FixedPoint = i64;

const FIXED_POINTS_PER_NAT: f64 = (1_u64 << 40) as f64;

pub(super) fn fixed_point(nats: f64) -> FixedPoint {
    (nats * FIXED_POINTS_PER_NAT).round() as FixedPoint
}

pub(super) fn nats(fixed_point: FixedPoint) -> f64 {
    fixed_point as f64 / FIXED_POINTS_PER_NAT
}

/// (k, n) with 1 ≤ k ≤ n ≤ 15 as one number below 120: all k of one n in a row.
pub(super) type LookClass = u8;

/// What k is added to, wrapping, for the class of (k, n).
pub(super) const fn class_offset(looks: u8) -> LookClass {
    match looks.checked_sub(1) {
        Some(fewer) => (looks * fewer / 2).wrapping_sub(1),
        None => 0,
    }
}

/// Weights by [`LookClass`]; a power of 2, so that an index can be reduced to it instead of
/// checked.
pub(super) const CLASSES: usize = 128;
pub(super) type ClassWeights = [FixedPoint; CLASSES];

/// A query, prepared for the places of an index; reusing it saves allocations.
#[derive(Clone, Debug, Default)]
pub struct QueryWeights {
    /// C_n(Z) by n.
    pub(super) empty_place: [f64; Appearance::MAX_LOOKS as usize + 1],
    pub(super) words: Vec<WordWeight>,
    /// Per word of `words`, if there are places with other looks than one.
    pub(super) of_classes: Vec<ClassWeights>,
    /// Per word of the vocabulary that is informative: its index in `words`.
    positions: Vec<u32>,
    /// Per word of the vocabulary a bit: whether it is in `words`. Most are not, and the bits are
    /// near.
    informative: Vec<u64>,
}

/// By how much a query that shows a word as it does differs from one that shows neither it nor its
/// parent.
#[derive(Clone, Copy, Debug)]
pub(super) struct WordWeight {
    pub(super) word: WordId,
    /// At a place whose one look showed the word.
    pub(super) of_one_look: FixedPoint,
}

impl QueryWeights {
    /// Prepares a query for places of at most `most_looks`.
    pub(super) fn prepare(&mut self, model: &ObservationModel, informative: &[WordState], most_looks: u8) {
        // Before the sizes change: the query before may have been of a larger vocabulary.
        self.words.drain(..).for_each(|weight| self.informative[weight.word.index() / 64] = 0);
        self.positions.resize(model.vocabulary_len(), 0);
        self.informative.resize(model.vocabulary_len().div_ceil(64), 0);
        self.words.extend(informative.iter().map(|&state| WordWeight {
            word: state.word,
            of_one_look: fixed_point(model.one_look(state).at_places_with_it),
        }));
        for (position, weight) in (0..).zip(&self.words) {
            self.positions[weight.word.index()] = position;
            self.informative[weight.word.index() / 64] |= 1 << (weight.word.number() % 64);
        }
        self.of_classes.clear();
        self.empty_place = std::array::from_fn(|looks| model.log_likelihood_of_nothing(looks as u8));
        if most_looks > 1 {
            self.weigh_classes(model, informative, most_looks);
        } else {
            for looks in 0..=most_looks {
                self.empty_place[usize::from(looks)] =
                    model.log_likelihood_of_empty_place(informative, looks);
            }
        }
    }

    /// Where a word is in `words`; `None` if it is not informative.
    #[inline(always)]
    pub(super) fn position(&self, word: WordId) -> Option<usize> {
        let informative = self.informative[word.index() / 64] >> (word.number() % 64) & 1 == 1;
        informative.then(|| self.positions[word.index()] as usize)
    }

    /// What a word adds at a place whose one look showed it; `None` if it is not informative.
    pub(super) fn of_one_look(&self, word: WordId) -> Option<FixedPoint> {
        self.position(word).map(|position| self.words[position].of_one_look)
    }

    /// The weights of all (k, n) up to `most_looks`, and C_n(Z).
    fn weigh_classes(&mut self, model: &ObservationModel, informative: &[WordState], most_looks: u8) {
        self.of_classes.resize(informative.len(), [0; CLASSES]);
        let mut gains = [0.0; COUNTS];
        for ((&state, word), of_classes) in informative.iter().zip(&self.words).zip(&mut self.of_classes) {
            model.gains_over_unseen(state, most_looks, &mut gains);
            self.empty_place[0] += gains[0];
            for looks in 1..=most_looks {
                let first = usize::from(class_offset(looks).wrapping_add(1));
                let (without, with) =
                    (count_index(0, looks), count_index(1, looks)..=count_index(looks, looks));
                self.empty_place[usize::from(looks)] += gains[without];
                for (weight, gain) in of_classes[first..].iter_mut().zip(&gains[with]) {
                    *weight = fixed_point(gain - gains[without]);
                }
            }
            // To the bit what other blocks add.
            of_classes[usize::from(class_offset(1).wrapping_add(1))] = word.of_one_look;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_number_every_count_once() {
        let counts = (0..=Appearance::MAX_LOOKS).flat_map(|looks| (1..=looks).map(move |hits| (hits, looks)));
        let classes: Vec<u8> = counts.map(|(hits, looks)| class_offset(looks).wrapping_add(hits)).collect();
        assert_eq!(classes, (0..120).collect::<Vec<_>>());
    }

    #[test]
    fn fixed_points_are_near() {
        for value in [0.0, -700.25, 1e-9, 33.333] {
            assert!((nats(fixed_point(value)) - value).abs() <= 5e-13);
        }
    }
}
