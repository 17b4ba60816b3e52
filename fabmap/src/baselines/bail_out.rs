//! Accelerated FAB-MAP: places that cannot win are dropped before all words have been looked at
//! (Cummins & Newman, "Accelerated Appearance-Only SLAM", ICRA 2008).
//!
//! Words are taken in order of what they can say. After j of them the score of a place is known but
//! for the remainder R_j = Σ_{i > j} X_i, X_i being word i's gain at the share π_i of places that
//! have it and 0 at the others. Two places' remainders differ by a sum of mean 0 and variance V_j =
//! Σ 2 d_i² π_i (1 - π_i), with terms of at most M_j = max |d_i|. Bennett's inequality (1962)
//! bounds the chance that it exceeds Δ:
//!
//! P(S ≥ Δ) ≤ exp[-(V / M²) h(Δ M / V)], h(u) = (1 + u) ln(1 + u) - u
//!
//! Where the chance that a place makes up for its distance to the leader is small enough, it is
//! dropped.
//!
//! The inequality takes words for independent of each other. At real places they are not, and
//! remainders vary more than that. So some places of the map are scored to the end first, and V is
//! raised to what they show.

mod bennett;

use super::dense_scorer::DenseScorer;
use crate::likelihood::{COUNTS, WordState, count_index};
use crate::observation::{Observation, WordId};
use crate::slices;
use bennett::Remainder;

/// The chance, per query, that the place with the highest likelihood may be dropped: in (0, 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BailOutRisk(f64);

/// A number that is not a risk.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the risk of losing the best place must be above 0 and below 1, not {value}; 1e-3 is a good start")]
pub struct BailOutRiskError {
    /// The number given.
    pub value: f64,
}

/// What is known of all places after the losers were dropped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BailOutScores {
    /// ln p(Z | L_i): exact for survivors. For the others the logarithm of the mean likelihood of
    /// places with the same first words, so that a normaliser over all places is right on average;
    /// at most that of the best survivor, which none of them exceeds except with the given risk.
    pub log_likelihoods: Vec<f64>,
    /// The places whose value is exact, ascending.
    pub survivors: Vec<u32>,
    /// Terms of the sum over words and places that were evaluated.
    pub terms: u64,
}

/// A word that says something, with what it says.
struct WordTerm {
    word: WordId,
    /// By [`crate::likelihood::count_index`]: what a place adds beyond a place where the word was
    /// never seen.
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
    /// Every place starts with what its words say if the query shows none of them: that does not
    /// depend on the query.
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

    /// Scores some places to the end and has the remainders vary as much as theirs; gives the
    /// number of terms.
    fn measure_remainders(&self, terms: &[WordTerm], remainders: &mut [Remainder]) -> u64 {
        let mut sums = vec![0.0; self.sampled_places()];
        // From the last words to the first: what a place has summed up is the remainder after the
        // words before.
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
        let place = survivors[index];
        let score = scores[index];
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
mod tests;
