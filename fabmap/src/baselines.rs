//! What the recognizer is measured against. None of it is needed to recognise a place.
//!
//! - [`every_word_of_every_place`] and [`DenseScorer`]: the definition of the likelihood, term by
//!   term;
//! - [`DenseScorer::bail_out`]: the accelerated dense evaluation of Cummins & Newman (ICRA 2008);
//! - [`TfIdf`]: ranking by the cosine of bags of words (Sivic & Zisserman 2003).

mod bail_out;
mod dense_scorer;
mod tf_idf;

use rayon::prelude::*;

use crate::appearance::Appearance;
use crate::inverted_index::InvertedIndex;
use crate::observation::Observation;

pub use bail_out::{BailOutRisk, BailOutRiskError, BailOutScores};
pub use dense_scorer::DenseScorer;
pub use tf_idf::TfIdf;

/// ln p(Z | L_i) of every place of an index, from every word of the vocabulary: the same values as
/// the index gives, within 1e-9 of them relatively. `scores` is overwritten.
pub fn every_word_of_every_place(index: &InvertedIndex, observation: &Observation, scores: &mut Vec<f64>) {
    let places: Vec<Appearance> = index.appearances().collect();
    let dense = |place| index.model().dense_log_likelihood(observation, place);
    places.par_iter().map(dense).collect_into_vec(scores);
}
