//! How alike two places look: what one shows, as evidence for the other.
//!
//! A place is taken as what it usually shows, once: so two places are as alike however often each
//! was visited. The evidence is ln p(Z | L) - ln p(Z | L_avg), nats, where Z is what the one place
//! usually shows, L a place whose only look showed what the other usually does, and L_avg the
//! average place, which stands for somewhere new. Words count for what the model says that they
//! are worth: one that every place shows says little. Above 0 the other place explains Z better
//! than somewhere new does.
//!
//! It is not symmetric: a place that shows little says little, whatever it is compared with.

use std::sync::Arc;

use crate::appearance::Appearance;
use crate::inverted_index::{InvertedIndex, QueryWeights};
use crate::likelihood::ObservationModel;
use crate::observation::{Observation, WordId};

impl Appearance {
    /// What the place usually shows: the words that half of its looks showed or more.
    #[must_use]
    pub fn usual_look(&self) -> Observation {
        let looks = u32::from(self.looks());
        let usual = self.word_hits().filter(|&(_, hits)| 2 * u32::from(hits) >= looks);
        Observation::of_ascending(usual.map(|(word, _)| word).collect::<Vec<WordId>>())
    }
}

/// Places that others are compared with.
#[derive(Clone, Debug)]
pub struct Likeness {
    index: InvertedIndex,
}

/// Buffers that are reused between places; see [`Likeness::evidence_into`].
#[derive(Clone, Debug, Default)]
pub struct LikenessWorkspace {
    weights: QueryWeights,
}

impl Likeness {
    /// Of places by what they usually show.
    ///
    /// # Panics
    /// If a look is of another vocabulary than the model's.
    #[must_use]
    pub fn with<'a>(
        model: Arc<ObservationModel>,
        usual_looks: impl IntoIterator<Item = &'a Observation>,
    ) -> Self {
        let mut index = InvertedIndex::new(model);
        index.extend(usual_looks.into_iter().map(Appearance::of));
        Self { index }
    }

    /// How much of what a place usually shows speaks for each of these places, in their order and in
    /// nats. `evidence` is overwritten.
    pub fn evidence_into(
        &self,
        usual_look: &Observation,
        workspace: &mut LikenessWorkspace,
        evidence: &mut Vec<f64>,
    ) {
        let model = self.index.model();
        let informative = model.informative_words(usual_look);
        self.index.log_likelihoods_into(&informative, &mut workspace.weights, evidence);
        let somewhere_new = model.log_likelihood_of_empty_place(&informative, 0);
        evidence.iter_mut().for_each(|nats| *nats -= somewhere_new);
    }
}

/// What a place's usual look says for itself, nats: the most that any place can be alike to it, but
/// for places that show the same and more.
#[must_use]
pub fn evidence_of_itself(model: &ObservationModel, usual_look: &Observation) -> f64 {
    let informative = model.informative_words(usual_look);
    let itself = model.single_looks(usual_look).log_likelihood(usual_look);
    itself - model.log_likelihood_of_empty_place(&informative, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_worlds::{self, World};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn evidence_is_what_the_dense_equations_say(world in test_worlds::worlds(25, 6)) {
            let World { model, appearances, .. } = world;
            let looks: Vec<Observation> = appearances.iter().map(Appearance::usual_look).collect();
            let model = Arc::new(model);
            let likeness = Likeness::with(model.clone(), &looks);
            let (mut workspace, mut evidence) = (LikenessWorkspace::default(), Vec::new());
            for (row, look) in looks.iter().enumerate() {
                likeness.evidence_into(look, &mut workspace, &mut evidence);
                prop_assert_eq!(evidence.len(), looks.len());
                let somewhere_new = model.dense_log_likelihood_of_average_place(look);
                for (other, &nats) in looks.iter().zip(&evidence) {
                    let dense = model.dense_log_likelihood(look, &Appearance::of(other)) - somewhere_new;
                    prop_assert!((nats - dense).abs() < 1e-9 * dense.abs().max(1.0), "{nats} for {dense}");
                }
                let itself = evidence_of_itself(&model, look);
                prop_assert!((evidence[row] - itself).abs() < 1e-9 * itself.abs().max(1.0));
            }
        }

        #[test]
        fn usual_words_are_those_that_half_of_the_looks_showed(world in test_worlds::worlds(25, 3)) {
            for appearance in &world.appearances {
                let usual = appearance.usual_look();
                for word in WordId::first(25) {
                    let half = 2 * u32::from(appearance.hits(word)) >= u32::from(appearance.looks());
                    prop_assert_eq!(usual.contains(word), half, "{} of {}", appearance.hits(word), appearance.looks());
                }
            }
        }
    }
}
