//! What merging simulated drives came to.

use serde::Serialize;
use topomap::merging::{MergePlan, Verdict};

use super::MergeOptions;
use crate::timing::median;

/// What came out.
#[derive(Serialize)]
pub(crate) struct MergeReport {
    /// What was merged.
    pub scenario: String,
    /// Of the first trial.
    pub seed: u64,
    /// Trials.
    pub trials: u32,
    /// Share of matches that were made up.
    pub false_match_share: f64,
    /// Median error of the trajectories on the merged map, after the best rigid alignment.
    pub rmse_m: f64,
    /// The largest.
    pub rmse_m_worst: f64,
    /// Median of the error over that of the map built in one go, where there is one.
    pub rmse_ratio: Option<f64>,
    /// The largest.
    pub rmse_ratio_worst: Option<f64>,
    /// Merges.
    pub merges: usize,
    /// Merges most of whose matches are of different places.
    pub false_merges: usize,
    /// Maps that stayed apart although they overlap.
    pub missed_overlaps: usize,
    /// Matches of merges.
    pub matches: usize,
    /// Those of them that are of different places.
    pub false_matches: usize,
    /// Median time from two maps to one.
    pub seconds: f64,
    /// Trial by trial.
    pub runs: Vec<MergeRun>,
}

/// One trial.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct MergeRun {
    /// Its seed.
    pub seed: u64,
    /// Maps before.
    pub maps: usize,
    /// Places of each.
    pub places: Vec<usize>,
    pub merges: usize,
    pub false_merges: usize,
    pub missed_overlaps: usize,
    pub matches: usize,
    pub false_matches: usize,
    pub rmse_m: f64,
    /// The same of the map built in one go.
    pub one_go_rmse_m: Option<f64>,
    /// Of each merge or refusal.
    pub seconds: Vec<f64>,
    /// What was said of each pair of maps.
    pub said: Vec<String>,
}

impl MergeReport {
    pub(super) fn of(scenario: String, options: &MergeOptions, runs: Vec<MergeRun>) -> Self {
        let sum = |of: fn(&MergeRun) -> usize| runs.iter().map(of).sum();
        let ratio = |run: &MergeRun| run.one_go_rmse_m.map(|one_go| run.rmse_m / one_go);
        let most = |values: Vec<f64>| values.into_iter().reduce(f64::max);
        let errors: Vec<f64> = runs.iter().map(|run| run.rmse_m).collect();
        let ratios: Vec<f64> = runs.iter().filter_map(ratio).collect();
        Self {
            scenario,
            seed: options.seed,
            trials: options.trials,
            false_match_share: options.false_matches,
            rmse_m: median(errors.clone()).unwrap_or(0.0),
            rmse_m_worst: most(errors).unwrap_or(0.0),
            rmse_ratio: median(ratios.clone()),
            rmse_ratio_worst: most(ratios),
            merges: sum(|run| run.merges),
            false_merges: sum(|run| run.false_merges),
            missed_overlaps: sum(|run| run.missed_overlaps),
            matches: sum(|run| run.matches),
            false_matches: sum(|run| run.false_matches),
            seconds: median(runs.iter().flat_map(|run| run.seconds.clone()).collect()).unwrap_or(0.0),
            runs,
        }
    }
}

impl MergeRun {
    /// A merge, of whose matches so many are of different places.
    pub(super) fn count(&mut self, plan: &MergePlan, wrong: usize) {
        self.merges += 1;
        self.matches += plan.matches.len();
        self.false_matches += wrong;
        self.false_merges += usize::from(2 * wrong > plan.matches.len());
    }
}

/// Why, or by what, of so many matches.
pub(super) fn said(verdict: &Verdict, matches: usize) -> String {
    match verdict {
        Verdict::Overlap(plan) => format!(
            "{} of {matches} matches, rival {}, {} of {} places confirmed, cost {:.0} to {:.0}",
            plan.matches.len(),
            plan.rival_support,
            plan.overlap.confirmed,
            plan.overlap.places,
            plan.cost_before,
            plan.cost_after,
        ),
        Verdict::Apart(apart) => apart.to_string(),
    }
}
