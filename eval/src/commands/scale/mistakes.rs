//! How often a place that nobody has seen is taken for a known one, and a known one for another.

use fabmap::place_filter::MotionPrior;
use fabmap::recognizer::Recognizer;
use rayon::prelude::*;
use serde::Serialize;

use super::source::Query;
use crate::calibration::{Prediction, Reliability};
use crate::dataset::Verdict;

/// Posterior from which the most probable place counts as accepted.
const THRESHOLD: f64 = 0.5;

/// Queries of the whole map, each by itself: nothing is expected of motion.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct MistakesReport {
    /// Queries made somewhere new.
    pub(super) new_queries: usize,
    /// Those of them for which a place was accepted.
    pub(super) false_accepts: usize,
    /// Queries made at a place of the map.
    pub(super) revisit_queries: usize,
    /// Those of them for which that place was accepted.
    pub(super) revisits_accepted: usize,
    /// Those of them for which another place was.
    pub(super) revisits_misplaced: usize,
    /// Expected calibration error of the posterior of the most probable place.
    pub(super) ece: Option<f64>,
}

/// What one query came to.
struct Answer {
    /// Where it was made; `None` for a new place.
    truth: Option<u32>,
    best_place: u32,
    posterior: f64,
}

impl Answer {
    fn is_right(&self) -> bool {
        self.truth == Some(self.best_place)
    }

    fn prediction(&self) -> Prediction {
        let verdict = if self.is_right() { Verdict::True } else { Verdict::False };
        Prediction { probability: self.posterior, verdict }
    }
}

/// Asks the recognizer every query, on these threads.
pub(super) fn count(
    recognizer: &Recognizer,
    queries: &[Query],
    threads: &rayon::ThreadPool,
) -> MistakesReport {
    let answer = |query: &Query| {
        let recognition = recognizer.recognize(&query.observation, &MotionPrior::even());
        let (best_place, posterior) = recognition.posterior.best_place().unwrap_or_default();
        Answer { truth: query.place, best_place, posterior }
    };
    let answers: Vec<Answer> = threads.install(|| queries.par_iter().map(answer).collect());
    let accepted = |which: fn(&Answer) -> bool| {
        answers.iter().filter(|answer| answer.posterior >= THRESHOLD && which(answer)).count()
    };
    let predictions: Vec<Prediction> = answers.iter().map(Answer::prediction).collect();
    let new_queries = answers.iter().filter(|answer| answer.truth.is_none()).count();
    MistakesReport {
        new_queries,
        false_accepts: accepted(|answer| answer.truth.is_none()),
        revisit_queries: answers.len() - new_queries,
        revisits_accepted: accepted(Answer::is_right),
        revisits_misplaced: accepted(|answer| answer.truth.is_some() && !answer.is_right()),
        ece: Reliability::of(&predictions).expected_calibration_error(),
    }
}
