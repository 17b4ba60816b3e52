//! What merging simulated drives came to.

use serde::Serialize;

use super::MergeOptions;
use crate::choices::own_name;
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
    pub(super) fn of(options: &MergeOptions, runs: Vec<MergeRun>) -> Self {
        let sum = |of: fn(&MergeRun) -> usize| runs.iter().map(of).sum();
        let ratio = |run: &MergeRun| run.one_go_rmse_m.map(|one_go| run.rmse_m / one_go);
        let most = |values: Vec<f64>| values.into_iter().reduce(f64::max);
        let errors: Vec<f64> = runs.iter().map(|run| run.rmse_m).collect();
        let ratios: Vec<f64> = runs.iter().filter_map(ratio).collect();
        Self {
            scenario: own_name(&options.scenario),
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

    pub(super) fn table(&self) -> String {
        let mut table = format!(
            "{}, {} trials\nseed  maps  merges  false  missed  matches  false  rmse m  one go m\n",
            self.scenario, self.trials
        );
        for run in &self.runs {
            let one_go = run.one_go_rmse_m.map_or("–".to_owned(), |metres| format!("{metres:.2}"));
            table += &format!(
                "{:<6}{:>4}{:>8}{:>7}{:>8}{:>9}{:>7}{:>8.2}{one_go:>10}\n",
                run.seed,
                run.maps,
                run.merges,
                run.false_merges,
                run.missed_overlaps,
                run.matches,
                run.false_matches,
                run.rmse_m,
            );
        }
        table
            + &format!(
                "rmse {:.2} m, at most {:.2} m; over that of one go {}; {} merges, {} false; {} missed; {:.2} s\n",
                self.rmse_m,
                self.rmse_m_worst,
                self.rmse_ratio.map_or("–".to_owned(), |ratio| format!("{ratio:.2}")),
                self.merges,
                self.false_merges,
                self.missed_overlaps,
                self.seconds,
            )
    }
}
