//! The baseline: the most similar earlier image by tf-idf, without probabilities, places or time.

use anyhow::Result;
use fabmap::baselines::TfIdf;
use fabmap::model::Model;
use fabmap::recognizer::{Stage, StageObserver};

use super::{Proposal, Ranked, Ranking};
use crate::observing::Observed;
use crate::timing::FrameWatch;

/// Ranks earlier frames by the cosine of their tf-idf vectors.
#[derive(Clone, Debug)]
pub(crate) struct TfIdfRanking {
    tf_idf: TfIdf,
    gap: usize,
}

impl TfIdfRanking {
    /// Words weighted by the model's sampling set; frames closer than `gap` are not proposed.
    pub(crate) fn new(model: &Model, gap: usize) -> Self {
        Self { tf_idf: TfIdf::new(model.sampling_set(), model.vocabulary().len()), gap }
    }
}

impl Ranking for TfIdfRanking {
    fn rank(&mut self, index: usize, seen: Observed, mut watch: FrameWatch) -> Result<Ranked> {
        let observation = &seen.observation;
        let words = observation.len();
        let similarities = self.tf_idf.similarities(observation);
        watch.completed(Stage::Likelihood);
        self.tf_idf.add(observation);
        let far_enough = (index + 1).saturating_sub(self.gap);
        let proposal = best(&similarities[..far_enough.min(similarities.len())]);
        Ok(Ranked {
            words,
            proposal,
            decision: None,
            candidates: Vec::new(),
            times: watch.stop(),
            similarities,
        })
    }

    fn places(&self) -> Option<usize> {
        None
    }
}

/// The most similar frame, the earliest of equal ones.
fn best(similarities: &[f64]) -> Option<Proposal> {
    let mut best: Option<Proposal> = None;
    for (frame, &score) in similarities.iter().enumerate() {
        if best.is_none_or(|best| score > best.score) {
            best = Some(Proposal { frame, score, posterior: None, probability: None });
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_earliest_of_the_most_similar_is_proposed() {
        assert_eq!(best(&[]), None);
        let best = |similarities| best(similarities).map(|best| (best.frame, best.score));
        assert_eq!(best(&[0.0, 0.0]), Some((0, 0.0)));
        assert_eq!(best(&[0.1, 0.7, 0.3, 0.7]), Some((1, 0.7)));
    }
}
