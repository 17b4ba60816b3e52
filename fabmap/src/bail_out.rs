//! Accelerated FAB-MAP: places that cannot win are dropped before all words have been looked at.
//! Cummins & Newman, ICRA 2008.
//!
//! Words are taken in order of what they can say. After some of them the score of a place is known but for the rest, and
//! that is bounded by Bennett's inequality: where the chance that it makes up for the distance to the leader is small
//! enough, the place is dropped.
//!
//! The inequality takes words for independent of each other. At real places they are not, and the rest of a place varies
//! more than that: so some places of the map are scored to the end first, and show by how much.

mod bennett;
mod dense_scorer;

pub use dense_scorer::DenseScorer;

use crate::likelihood::{COUNTS, WordState, count_index};
use crate::observation::{Observation, WordId};
use crate::slices;
use bennett::Remainder;

/// The chance, per query, that the place with the highest likelihood may be dropped: in (0, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BailOutRisk(f64);

/// A number that is no risk.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the risk of losing the best place must be above 0 and below 1, not {value}; 1e-3 is a good start")]
pub struct BailOutRiskError {
    /// The number given.
    pub value: f64,
}

/// What is known of all places after the losers were dropped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BailOutScores {
    /// ln p(Z | L_i): exact for survivors. For the others the logarithm of the mean likelihood that places with their
    /// first words come to, so that a normaliser over all places is right on average; at most that of the best survivor,
    /// which none of them exceeds but with the chance that was given.
    pub log_likelihoods: Vec<f64>,
    /// The places whose value is exact, ascending.
    pub survivors: Vec<u32>,
    /// Terms of the sum over words and places that were evaluated.
    pub terms: u64,
}

/// A word that says something, with what it says.
struct WordTerm {
    word: WordId,
    /// By [`crate::likelihood::count_index`]: what a place adds beyond a place where the word was never seen.
    gains: [f64; COUNTS],
    /// The largest of those, without sign.
    largest: f64,
    /// The gain of a word that one look showed: of most places that have the word.
    typical: f64,
}

/// Words between one dropping of places and the next.
const WORDS_BETWEEN: usize = 16;

impl BailOutRisk {
    /// # Errors
    /// [`BailOutRiskError`] if it is not in (0, 1).
    pub fn new(value: f64) -> Result<Self, BailOutRiskError> {
        if value > 0.0 && value < 1.0 { Ok(Self(value)) } else { Err(BailOutRiskError { value }) }
    }
}

impl Default for BailOutRisk {
    /// A thousandth.
    fn default() -> Self {
        Self(1e-3)
    }
}

impl DenseScorer {
    /// ln p(Z | L_i) of the places that may be the best, and bounds for the others.
    ///
    /// Every place starts with what its words say if the query shows none of them: that does not depend on the query.
    #[must_use]
    pub fn bail_out(&self, observation: &Observation, risk: BailOutRisk) -> BailOutScores {
        let informative = self.model().informative_words(observation);
        let terms = self.by_information(&informative);
        let mut remainders =
            Remainder::after_each(&terms, |word| self.share_of_places_with(word), WORDS_BETWEEN);
        let sampled_terms = self.measure_remainders(&terms, &mut remainders);
        // Any place may be the one that catches up, after any block: Boole's inequality.
        let risk_of_each = risk.0 / (remainders.len() * self.places()).max(1) as f64;

        let mut survivors: Vec<u32> = (0..self.places() as u32).collect();
        let mut scores = self.scores_of_nothing(&informative);
        let mut result = BailOutScores {
            log_likelihoods: scores.clone(),
            terms: sampled_terms,
            ..BailOutScores::default()
        };
        for (block, remainder) in terms.chunks(WORDS_BETWEEN).zip(&remainders) {
            for term in block {
                self.add_gains(term.word, &term.gains, &survivors, &mut scores);
            }
            result.terms += (block.len() * survivors.len()) as u64;
            if survivors.len() <= 1 {
                continue;
            }
            let best = slices::largest(&scores);
            let least = best - remainder.overtaking_margin(risk_of_each);
            let expected = remainder.log_of_mean_likelihood(risk_of_each);
            drop_losers(&mut survivors, &mut scores, least, |place, score| {
                result.log_likelihoods[place as usize] = score + expected;
            });
        }
        let best = slices::largest(&scores);
        result.log_likelihoods.iter_mut().for_each(|score| *score = score.min(best));
        for (&place, score) in survivors.iter().zip(scores) {
            result.log_likelihoods[place as usize] = score;
        }
        BailOutScores { survivors, ..result }
    }

    /// Scores some places to the end and has the remainders vary as much as theirs; gives the number of terms.
    fn measure_remainders(&self, terms: &[WordTerm], remainders: &mut [Remainder]) -> u64 {
        let mut sums = vec![0.0; self.sampled_places()];
        // From the last words to the first: what a place has summed up is the remainder after the words before.
        for (block, remainder) in terms.chunks(WORDS_BETWEEN).zip(remainders).rev() {
            remainder.vary_as(&sums);
            for term in block {
                self.add_gains_of_sample(term.word, &term.gains, &mut sums);
            }
        }
        (terms.len() * sums.len()) as u64
    }

    /// The informative words, those first that can say most.
    fn by_information(&self, informative: &[WordState]) -> Vec<WordTerm> {
        let term = |&state: &WordState| {
            let gains = self.gains_of_hits(state);
            let largest = gains.iter().fold(0.0, |largest: f64, gain| largest.max(gain.abs()));
            WordTerm { word: state.word, gains, largest, typical: gains[count_index(1, 1)] }
        };
        let on_places = |state: &&WordState| self.share_of_places_with(state.word) > 0.0;
        let mut terms: Vec<WordTerm> = informative.iter().filter(on_places).map(term).collect();
        terms.sort_unstable_by(|a, b| b.largest.total_cmp(&a.largest).then(a.word.cmp(&b.word)));
        terms
    }
}

/// Keeps places with at least `least`, in order.
fn drop_losers(
    survivors: &mut Vec<u32>,
    scores: &mut Vec<f64>,
    least: f64,
    mut dropped: impl FnMut(u32, f64),
) {
    let mut kept = 0;
    for index in 0..survivors.len() {
        let (place, score) = (survivors[index], scores[index]);
        if score >= least {
            (survivors[kept], scores[kept]) = (place, score);
            kept += 1;
        } else {
            dropped(place, score);
        }
    }
    survivors.truncate(kept);
    scores.truncate(kept);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use crate::appearance::Appearance;
    use crate::new_place::log_sum_exp;
    use crate::test_worlds::{self, World};
    use proptest::prelude::*;

    fn best_of(scores: &[f64]) -> usize {
        (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(b.cmp(&a))).unwrap()
    }

    proptest! {
        #[test]
        fn survivors_have_the_dense_likelihood(world in test_worlds::worlds(60, 12), risk in 1e-9..0.9f64) {
            let World { model, appearances, observations } = world;
            let scorer = DenseScorer::new(Arc::new(model), &appearances);
            for z in &observations {
                let scores = scorer.bail_out(z, BailOutRisk::new(risk).unwrap());
                prop_assert_eq!(scores.log_likelihoods.len(), appearances.len());
                prop_assert!(!scores.survivors.is_empty());
                for &place in &scores.survivors {
                    let dense = scorer.model().dense_log_likelihood(z, &appearances[place as usize]);
                    let found = scores.log_likelihoods[place as usize];
                    prop_assert!((dense - found).abs() <= 1e-9 * dense.abs().max(1.0), "{dense} {found}");
                }
            }
        }

        #[test]
        fn the_dense_scorer_is_the_dense_evaluation(world in test_worlds::worlds(60, 12)) {
            let World { model, appearances, observations } = world;
            let scorer = DenseScorer::new(Arc::new(model), &appearances);
            for z in &observations {
                for (found, place) in scorer.log_likelihoods(z).iter().zip(&appearances) {
                    let dense = scorer.model().dense_log_likelihood(z, place);
                    prop_assert!((dense - found).abs() <= 1e-9 * dense.abs().max(1.0), "{dense} {found}");
                }
            }
        }
    }

    /// Queries of which none was made at a place of the map: the best is the luckiest of unrelated places, the hardest
    /// case. With a risk of 5 % at most 5 % may be lost, six standard deviations allowed. And the normaliser is right but
    /// for as many.
    #[test]
    fn the_best_place_is_lost_no_more_often_than_the_risk_says() {
        let World { model, observations, .. } = test_worlds::fixed(300, 3000, 3);
        let (places, queries) = observations.split_at(1000);
        let appearances: Vec<Appearance> = places.iter().map(Appearance::of).collect();
        let scorer = DenseScorer::new(Arc::new(model), &appearances);
        let risk = BailOutRisk::new(0.05).unwrap();
        let (mut lost, mut wrong, mut dropped) = (0, 0, 0);
        for z in queries {
            let exact = scorer.log_likelihoods(z);
            let scores = scorer.bail_out(z, risk);
            lost += usize::from(!scores.survivors.contains(&(best_of(&exact) as u32)));
            wrong += usize::from((log_sum_exp(&scores.log_likelihoods) - log_sum_exp(&exact)).abs() > 0.1);
            dropped += places.len() - scores.survivors.len();
        }
        let most = 0.05 * queries.len() as f64 + 6.0 * (0.05 * 0.95 * queries.len() as f64).sqrt();
        assert!(lost as f64 <= most, "{lost} of {} lost", queries.len());
        assert!(wrong as f64 <= most, "{wrong} of {} normalisers are wrong", queries.len());
        assert!(dropped > places.len() * queries.len() / 2, "hardly any place is dropped: {dropped}");
    }

    #[test]
    fn revisits_are_found_with_few_terms() {
        let World { model, observations, .. } = test_worlds::fixed(2000, 400, 8);
        let appearances: Vec<Appearance> = observations.iter().map(Appearance::of).collect();
        let scorer = DenseScorer::new(Arc::new(model), &appearances);
        let all = (observations.len() * 2000) as f64;
        for (place, z) in observations.iter().enumerate().step_by(17) {
            let scores = scorer.bail_out(z, BailOutRisk::default());
            assert_eq!(best_of(&scores.log_likelihoods), place);
            assert!(scores.terms as f64 <= 0.25 * all, "{} of {all} terms", scores.terms);
        }
    }

    #[test]
    fn what_is_no_risk_is_refused() {
        for value in [0.0, 1.0, -1.0, f64::NAN] {
            assert!(BailOutRisk::new(value).is_err(), "{value}");
        }
        let nobody = DenseScorer::new(Arc::new(test_worlds::fixed(5, 1, 1).model), &[]);
        assert_eq!(
            nobody.bail_out(&Observation::default(), BailOutRisk::default()),
            BailOutScores::default()
        );
    }
}
