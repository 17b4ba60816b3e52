//! Why a place was believed, word by word.

use crate::appearance::{Appearance, PlaceId};
use crate::likelihood::ObservationModel;
use crate::new_place::NewPlaceMethod;
use crate::observation::{Observation, WordId};
use crate::recognition::Recognition;

/// Why one place got its posterior for one observation.
///
/// ln p(Z | L_i) - ln p(Z | L_avg) is a sum over all words. It is shown against the average place
/// whatever new-place method decides, because that comparison has a part for each word.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// The place explained.
    pub place: PlaceId,
    /// p(L_i) before the observation.
    pub prior: f64,
    /// p(L_i | Z).
    pub posterior: f64,
    /// p(new | Z).
    pub new_place_posterior: f64,
    /// ln p(Z | L_i), nats.
    pub log_likelihood: f64,
    /// ln p(Z | L_new) by `new_place_method`, nats: the term that competes.
    pub new_place_log_likelihood: f64,
    /// How the new-place term was found.
    pub new_place_method: NewPlaceMethod,
    /// ln p(Z | L_avg), nats: what the words are compared with.
    pub average_place_log_likelihood: f64,
    /// Words that speak for the place, strongest first.
    pub words_for: Vec<WordEvidence>,
    /// Words that speak against it, strongest first.
    pub words_against: Vec<WordEvidence>,
    /// Sum over all words not listed, nats.
    pub other_words_nats: f64,
}

/// What one word says for (above 0) or against a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WordEvidence {
    /// The word q.
    pub word: WordId,
    /// z_q: whether the query shows it.
    pub seen: bool,
    /// How often the place showed it (k).
    pub hits: u8,
    /// How often the place was looked at (n).
    pub looks: u8,
    /// ln p(z_q | z_pq, L_i) - ln p(z_q | z_pq, L_avg), nats.
    pub nats: f64,
}

impl Explanation {
    pub(crate) fn new(
        model: &ObservationModel,
        new_place_method: NewPlaceMethod,
        observation: &Observation,
        recognition: &Recognition,
        place: PlaceId,
        appearance: &Appearance,
        words: usize,
    ) -> Option<Self> {
        let index = place.index();
        let average_place_log_likelihood = model.dense_log_likelihood_of_average_place(observation);
        let log_likelihood = *recognition.log_likelihoods.get(index)?;
        let (words_for, words_against) = strongest_words(model, observation, appearance, words);
        let listed: f64 = words_for.iter().chain(&words_against).map(|evidence| evidence.nats).sum();
        Some(Self {
            place,
            prior: recognition.prior.of(place)?,
            posterior: *recognition.posterior.places.get(index)?,
            new_place_posterior: recognition.posterior.new_place,
            log_likelihood,
            new_place_log_likelihood: recognition.new_place_log_likelihood,
            new_place_method,
            average_place_log_likelihood,
            words_for,
            words_against,
            other_words_nats: log_likelihood - average_place_log_likelihood - listed,
        })
    }
}

fn strongest_words(
    model: &ObservationModel,
    observation: &Observation,
    appearance: &Appearance,
    words: usize,
) -> (Vec<WordEvidence>, Vec<WordEvidence>) {
    let looks = appearance.looks();
    let evidence = |word: WordId| {
        let state = model.word_state(word, observation);
        let hits = appearance.hits(word);
        let nats = model.log_term(state, hits, looks) - model.log_term(state, 0, 0);
        WordEvidence { word, seen: state.seen, hits, looks, nats }
    };
    let mut all: Vec<WordEvidence> = WordId::first(model.vocabulary_len()).map(evidence).collect();
    all.sort_by(|a, b| b.nats.total_cmp(&a.nats).then_with(|| a.word.cmp(&b.word)));
    let words_for = all.iter().copied().take(words).take_while(|evidence| evidence.nats > 0.0).collect();
    let words_against =
        all.iter().rev().copied().take(words).take_while(|evidence| evidence.nats < 0.0).collect();
    (words_for, words_against)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::new_place::NewPlaceTerm;
    use crate::place_filter::{FilterSettings, MotionPrior, PlaceFilter};
    use crate::test_worlds::{self, World};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_words_add_up_to_the_likelihood(world in test_worlds::worlds(25, 3), words in 0..30usize) {
            let World { model, observations, appearances } = world;
            let z = &observations[0];
            let filter = PlaceFilter::new(FilterSettings::default()).unwrap();
            let log_likelihoods: Vec<f64> = appearances.iter().map(|place| model.dense_log_likelihood(z, place)).collect();
            let new_place_log_likelihood = model.dense_log_likelihood_of_average_place(z);
            let prior = filter.prior(&MotionPrior::even(), appearances.len());
            let term = NewPlaceTerm { log_likelihood: new_place_log_likelihood, temperature: 1.0 };
            let posterior = filter.update(&log_likelihoods, &term, &prior);
            let recognition = Recognition { log_likelihoods, new_place_log_likelihood, prior, posterior };
            let explain = |place: PlaceId, appearance| {
                Explanation::new(&model, NewPlaceMethod::MeanField, z, &recognition, place, appearance, words)
            };
            for (place, appearance) in PlaceId::all().zip(&appearances) {
                let explanation = explain(place, appearance).unwrap();
                let Explanation { words_for, words_against, .. } = &explanation;
                prop_assert!(words_for.iter().all(|evidence| evidence.nats > 0.0) && words_for.len() <= words);
                prop_assert!(words_against.iter().all(|evidence| evidence.nats < 0.0) && words_against.len() <= words);
                prop_assert!(words_for.is_sorted_by(|a, b| a.nats >= b.nats));
                if words >= 25 {
                    // With every word listed nothing is left over.
                    prop_assert!(explanation.other_words_nats.abs() < 1e-9, "{}", explanation.other_words_nats);
                }
            }
            prop_assert_eq!(explain(PlaceId::from_index(appearances.len()), &appearances[0]), None);
        }
    }
}
