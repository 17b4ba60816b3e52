//! What the measurement of the new-place term leaves behind.

use std::fmt::Write;

use fabmap::new_place::NewPlace;
use serde::Serialize;

use super::{Answer, NewPlaceOptions, WorkloadSource};
use crate::choices::{NEW_PLACE_METHODS, name_of};
use crate::error::EvalError;
use crate::files;
use crate::plots::{FalseAccepts, false_accepts_svg};
use crate::timing::median;

/// The measures of one run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NewPlaceReport {
    /// Posterior from which the most probable place counted as accepted.
    pub threshold: f64,
    /// Seed of the workload; null for one that was read from files.
    pub seed: Option<u64>,
    /// One entry per size of the map.
    pub maps: Vec<MapSizeReport>,
}

/// One map, asked by every method.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapSizeReport {
    /// Places on the map.
    pub places: usize,
    /// Queries made somewhere new.
    pub new_queries: usize,
    /// Queries made at a place of the map.
    pub revisit_queries: usize,
    /// Median time of the likelihoods of all places, in milliseconds.
    pub likelihood_ms_p50: f64,
    /// One entry per method.
    pub methods: Vec<MethodReport>,
}

/// One method on one map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodReport {
    /// Its name on the command line.
    pub method: &'static str,
    /// Queries from somewhere new for which a place was accepted.
    pub false_accepts: usize,
    /// Revisits for which the right place was accepted.
    pub revisits_accepted: usize,
    /// Revisits for which another place was.
    pub revisits_misplaced: usize,
    /// Expected calibration error of the posterior of the most probable place: 10 bins of equal mass.
    pub ece: f64,
    /// Median time of prior and posterior, in milliseconds.
    pub filter_ms_p50: f64,
    /// Median time of the new-place term, in milliseconds.
    pub new_place_ms_p50: f64,
    /// That time over the time of the rest of the update: likelihoods, prior and posterior.
    pub new_place_share_of_update: f64,
}

impl MapSizeReport {
    pub(super) fn new(
        places: usize,
        likelihood_ms: Vec<f64>,
        methods: &[NewPlace],
        answers: &[Vec<Answer>],
        threshold: f64,
    ) -> Self {
        let likelihood_ms_p50 = median(likelihood_ms).unwrap_or(0.0);
        let queries = answers.first().map_or(&[][..], Vec::as_slice);
        let new_queries = queries.iter().filter(|answer| answer.truth.is_none()).count();
        let of_method = |(method, answers): (&NewPlace, &Vec<Answer>)| {
            MethodReport::new(method, answers, likelihood_ms_p50, threshold)
        };
        Self {
            places,
            new_queries,
            revisit_queries: queries.len() - new_queries,
            likelihood_ms_p50,
            methods: methods.iter().zip(answers).map(of_method).collect(),
        }
    }
}

impl MethodReport {
    fn new(method: &NewPlace, answers: &[Answer], likelihood_ms_p50: f64, threshold: f64) -> Self {
        let accepted = |which: fn(&Answer) -> bool| {
            answers.iter().filter(|answer| answer.posterior >= threshold && which(answer)).count()
        };
        let time = |of: fn(&Answer) -> f64| median(answers.iter().map(of).collect()).unwrap_or(0.0);
        let (filter_ms_p50, new_place_ms_p50) =
            (time(|answer| answer.filter_ms), time(|answer| answer.new_place_ms));
        Self {
            method: name_of(NEW_PLACE_METHODS, &method.method()),
            false_accepts: accepted(|answer| answer.truth.is_none()),
            revisits_accepted: accepted(Answer::is_right),
            revisits_misplaced: accepted(|answer| answer.truth.is_some() && !answer.is_right()),
            ece: expected_calibration_error(
                answers.iter().map(|answer| (answer.posterior, answer.is_right())).collect(),
            ),
            filter_ms_p50,
            new_place_ms_p50,
            new_place_share_of_update: new_place_ms_p50 / (likelihood_ms_p50 + filter_ms_p50),
        }
    }
}

impl Answer {
    fn is_right(&self) -> bool {
        self.truth == Some(self.best_place)
    }
}

/// Σ_b (n_b / n) |mean probability - share that is right| over 10 bins of as equal a number as can
/// be, in order of probability; 0 of none.
fn expected_calibration_error(mut answers: Vec<(f64, bool)>) -> f64 {
    const BINS: usize = 10;
    answers.sort_by(|a, b| a.0.total_cmp(&b.0));
    let len = answers.len();
    let off_by = |bin: usize| {
        let bin = &answers[bin * len / BINS..(bin + 1) * len / BINS];
        bin.iter().map(|&(probability, right)| probability - f64::from(u8::from(right))).sum::<f64>().abs()
    };
    (0..BINS).map(off_by).sum::<f64>() / len.max(1) as f64
}

impl NewPlaceReport {
    pub(super) fn new(options: &NewPlaceOptions, maps: Vec<MapSizeReport>) -> Self {
        let seed = match &options.source {
            WorkloadSource::Drawn { settings, .. } => Some(settings.seed),
            WorkloadSource::Files(_) => None,
        };
        Self { threshold: options.threshold, seed, maps }
    }

    /// The table to stderr; table and plot to the folder for the results, if there is one.
    pub(super) fn write(&self, options: &NewPlaceOptions) -> Result<(), EvalError> {
        eprint!("{}", self.table());
        let Some(out) = &options.out else { return Ok(()) };
        let path = |name: &str| out.join(name);
        files::create_folder(out)?;
        let json = serde_json::to_vec_pretty(self)
            .map_err(|reason| EvalError::Write { path: path(SUMMARY), reason: reason.into() })?;
        files::write(&path(SUMMARY), &json)?;
        let svg = false_accepts_svg(&self.lines())
            .map_err(|reason| EvalError::Plot { path: path(PLOT), reason })?;
        files::write(&path(PLOT), svg.as_bytes())?;
        eprintln!("results: {} ({SUMMARY}, {PLOT})", out.display());
        Ok(())
    }

    fn table(&self) -> String {
        let mut table = "places  method         false accepts  revisits accepted  misplaced     ECE  \
                         term ms  of update\n"
            .to_owned();
        for map in &self.maps {
            for method in &map.methods {
                let percent = |count: usize, of: usize| 100.0 * count as f64 / of.max(1) as f64;
                let _ = writeln!(
                    table,
                    "{:6}  {:13}  {:11.2} %  {:15.2} %  {:9}  {:.4}  {:7.3}  {:7.1} %",
                    map.places,
                    method.method,
                    percent(method.false_accepts, map.new_queries),
                    percent(method.revisits_accepted, map.revisit_queries),
                    method.revisits_misplaced,
                    method.ece,
                    method.new_place_ms_p50,
                    100.0 * method.new_place_share_of_update,
                );
            }
        }
        table
    }

    fn lines(&self) -> Vec<FalseAccepts> {
        let of_method = |&(name, _): &(&'static str, _)| FalseAccepts {
            method: name,
            points: self
                .maps
                .iter()
                .filter_map(|map| {
                    let method = map.methods.iter().find(|method| method.method == name)?;
                    Some((map.places, method.false_accepts as f64 / map.new_queries.max(1) as f64))
                })
                .collect(),
        };
        NEW_PLACE_METHODS.iter().map(of_method).collect()
    }
}

const SUMMARY: &str = "new_place.json";
const PLOT: &str = "new_place.svg";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calibration_by_hand() {
        assert_eq!(expected_calibration_error(Vec::new()), 0.0);
        // Ten bins of one: |0.3 - 0| five times, |0.9 - 1| five times.
        let answers = (0..10).map(|i| if i < 5 { (0.3, false) } else { (0.9, true) }).collect();
        assert!((expected_calibration_error(answers) - 0.2).abs() < 1e-12);
        // Ten bins of two, a right one and a wrong one in each: half are right.
        let answers = (0..20).map(|i| (0.5, i % 2 == 0)).collect();
        assert!(expected_calibration_error(answers) < 1e-12);
        // Sure of all, right in 9 of 10, in no order.
        let answers = (0..100).map(|i| (1.0, i % 10 != 3)).collect();
        assert!((expected_calibration_error(answers) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn accepted_is_what_reaches_the_threshold() {
        let answer = |truth, best_place, posterior| Answer {
            truth,
            best_place,
            posterior,
            new_place_ms: 1.0,
            filter_ms: 2.0,
        };
        let answers = [
            answer(None, 4, 0.5),
            answer(None, 4, 0.49),
            answer(Some(4), 4, 0.9),
            answer(Some(4), 4, 0.1),
            answer(Some(4), 7, 0.6),
        ];
        let model = std::sync::Arc::new(fabmap::likelihood::ObservationModel::new(
            crate::workload::Workload::new(crate::workload::WorkloadSettings {
                words: 3,
                words_per_image: 1.0,
                ..Default::default()
            })
            .unwrap()
            .tree(),
            fabmap::detector::DetectorModel::default(),
            fabmap::likelihood::Dependence::ChowLiu,
        ));
        let method = NewPlace::new(fabmap::new_place::NewPlaceMethod::MeanField, &model, &[]).unwrap();
        let report = MapSizeReport::new(9, vec![2.0], &[method], &[answers.to_vec()], 0.5);
        assert_eq!((report.new_queries, report.revisit_queries), (2, 3));
        let MethodReport {
            false_accepts,
            revisits_accepted,
            revisits_misplaced,
            new_place_share_of_update,
            ..
        } = report.methods[0];
        assert_eq!((false_accepts, revisits_accepted, revisits_misplaced), (1, 1, 1));
        assert!((new_place_share_of_update - 0.25).abs() < 1e-12);
    }
}
