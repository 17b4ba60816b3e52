//! What a run of a sequence leaves behind: files for people and programs.

use std::fmt::Write;

use fabmap::model::Model;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::RecognizerSettings;
use serde::Serialize;
use topomap::mapper::MapperSettings;
use topomap::verification::{VerificationMethod, VerificationSettings};

use super::{JudgedFrame, Knobs, SequenceOptions, System, csv_files};
use crate::calibration::Reliability;
use crate::choices::{
    DEPENDENCES, NEW_PLACE_METHODS, RANKINGS, RankingName, SCORERS, VERIFICATION_METHODS, name_of,
};
use crate::dataset::{Sequence, Verdict};
use crate::error::EvalError;
use crate::false_pictures::{self, Mistake};
use crate::match_matrix::MatchMatrix;
use crate::precision_recall::PrecisionRecall;
use crate::timing::{FrameTimes, MedianTimes};
use crate::{files, plots};

/// The measures of one run; fractions lie in 0 to 1 and are null if no frame has a loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequenceReport {
    /// Frames streamed.
    pub frames: usize,
    /// Frames that have a loop.
    pub queries_with_loop: usize,
    /// See [`PrecisionRecall::recall_at_100_precision`].
    pub recall_at_100_precision: Option<f64>,
    /// See [`PrecisionRecall::average_precision`].
    pub average_precision: Option<f64>,
    /// Proposals that are not loops, whatever their score.
    pub false_positives: usize,
    /// Proposals that are, whatever their score.
    pub true_positives: usize,
    /// Places on the map at the end; null for a system without a map.
    pub places: Option<usize>,
    /// Loop closures accepted; null for a system that was given no threshold.
    pub loop_closures: Option<usize>,
    /// Those of them that are false.
    pub loop_closures_false: Option<usize>,
    /// The same as `loop_closures`.
    pub accepted: Option<usize>,
    /// The same as `loop_closures_false`.
    pub accepted_false: Option<usize>,
    /// Expected calibration error of the probability reported for the proposal; null for a system
    /// without probabilities. See [`Reliability::expected_calibration_error`].
    pub ece: Option<f64>,
    /// Median wall time per frame and stage, in milliseconds.
    pub ms_p50: MedianTimes,
}

impl SequenceReport {
    pub(super) fn new(
        frames: &[JudgedFrame],
        curve: &PrecisionRecall,
        reliability: &Reliability,
        places: Option<usize>,
        options: &SequenceOptions,
    ) -> Self {
        let closures: Option<Vec<Option<Verdict>>> = match options.system {
            System::FabMap(_) => Some(frames.iter().filter_map(JudgedFrame::accepted_closure).collect()),
            System::Likelihood(ref knobs) => knobs.closure_threshold.map(|threshold| {
                let log_odds = (threshold / (1.0 - threshold)).ln();
                frames.iter().filter_map(|frame| frame.accepted_above(log_odds)).collect()
            }),
            System::TfIdf { threshold } => threshold
                .map(|threshold| frames.iter().filter_map(|frame| frame.accepted_above(threshold)).collect()),
        };
        let is_false = |verdict: &&Option<Verdict>| **verdict == Some(Verdict::False);
        let times: Vec<FrameTimes> = frames.iter().map(|frame| frame.ranked.times).collect();
        let accepted = closures.as_ref().map(Vec::len);
        let accepted_false = closures.as_ref().map(|closures| closures.iter().filter(is_false).count());
        Self {
            frames: frames.len(),
            queries_with_loop: curve.queries_with_loop(),
            recall_at_100_precision: curve.recall_at_100_precision(),
            average_precision: curve.average_precision(),
            false_positives: curve.unthresholded().map_or(0, |all| all.false_proposals),
            true_positives: curve.unthresholded().map_or(0, |all| all.true_proposals),
            places,
            loop_closures: accepted,
            loop_closures_false: accepted_false,
            accepted,
            accepted_false,
            ece: reliability.expected_calibration_error(),
            ms_p50: MedianTimes::of(&times),
        }
    }

    fn table(&self, sequence: &Sequence, system: &str) -> String {
        let percent = |fraction: Option<f64>| match fraction {
            Some(fraction) => format!("{:.1} %", 100.0 * fraction),
            None => "none (no frame has a loop)".to_owned(),
        };
        let mut table = format!(
            "sequence                   {} ({} frames, {} with a loop)\n\
             system                     {system}\n\
             recall at 100 % precision  {}\n\
             average precision          {}\n\
             proposals                  {} true, {} false\n",
            sequence.name,
            self.frames,
            self.queries_with_loop,
            percent(self.recall_at_100_precision),
            percent(self.average_precision),
            self.true_positives,
            self.false_positives,
        );
        if let Some(places) = self.places {
            let _ = writeln!(table, "places                     {places}");
        }
        if let (Some(accepted), Some(wrong)) = (self.loop_closures, self.loop_closures_false) {
            let _ = writeln!(table, "loop closures accepted     {accepted}, {wrong} of them false");
        }
        if let Some(error) = self.ece {
            let _ = writeln!(table, "expected calibration error {error:.3}");
        }
        let stages = self.ms_p50.stages().into_iter();
        let stages: Vec<String> =
            stages.filter_map(|(stage, time)| time.map(|time| format!("{stage} {time:.2}"))).collect();
        let _ = writeln!(table, "median time in ms          {}", stages.join(", "));
        table
    }
}

/// Writes all files of a run, and the table to stderr.
pub(super) fn write_all(
    report: &SequenceReport,
    sequence: &Sequence,
    model: &Model,
    frames: &[JudgedFrame],
    (curve, reliability): (&PrecisionRecall, &Reliability),
    matrix: &MatchMatrix,
    options: &SequenceOptions,
) -> Result<(), EvalError> {
    let path = |name: &str| options.out.join(name);
    let not_drawn = |name: &str, reason: String| EvalError::Plot { path: path(name), reason };
    let system = in_words(&options.system);

    let not_written =
        |name: &str, reason: csv::Error| EvalError::Write { path: path(name), reason: reason.into() };
    let rows = csv_files::frames(sequence, frames).map_err(|reason| not_written(FRAMES, reason))?;
    files::write(&path(FRAMES), &rows)?;
    let rows = csv_files::curve(curve).map_err(|reason| not_written(CURVE, reason))?;
    files::write(&path(CURVE), &rows)?;
    let title = format!("{}: {system}", sequence.name);
    let svg = plots::precision_recall_svg(&title, curve).map_err(|reason| not_drawn(CURVE_PLOT, reason))?;
    files::write(&path(CURVE_PLOT), svg.as_bytes())?;
    let svg =
        plots::reliability_svg(&title, reliability).map_err(|reason| not_drawn(RELIABILITY_PLOT, reason))?;
    files::write(&path(RELIABILITY_PLOT), svg.as_bytes())?;
    let png = matrix.to_png(&sequence.truth).map_err(|error| not_drawn(MATRIX, error.to_string()))?;
    files::write(&path(MATRIX), &png)?;
    false_pictures::write_all(&path(MISTAKES), sequence, &mistakes(frames))?;
    let summary = Summary::new(report, sequence, model, options)?;
    files::write(
        &path(SUMMARY),
        &summary
            .to_json()
            .map_err(|reason| EvalError::Write { path: path(SUMMARY), reason: reason.into() })?,
    )?;

    eprint!("{}", report.table(sequence, &system));
    eprintln!(
        "results                    {} ({FRAMES}, {CURVE}, {CURVE_PLOT}, {RELIABILITY_PLOT}, {MATRIX}, {SUMMARY}, {MISTAKES}/)",
        options.out.display()
    );
    Ok(())
}

const FRAMES: &str = "frames.csv";
const CURVE: &str = "precision_recall.csv";
const CURVE_PLOT: &str = "precision_recall.svg";
const RELIABILITY_PLOT: &str = "reliability.svg";
const MATRIX: &str = "match_matrix.png";
const SUMMARY: &str = "summary.json";
const MISTAKES: &str = "mistakes";

/// The closures that were accepted and are false, and the false proposals of the highest scores, which are what
/// stands in the way of more recall.
fn mistakes(frames: &[JudgedFrame]) -> Vec<Mistake> {
    let proposal_of = |(index, frame): (usize, &JudgedFrame)| {
        let proposal = frame.ranked.proposal.filter(|_| frame.proposal_verdict == Some(Verdict::False))?;
        Some((proposal.score, Mistake { frame: index, held_for: proposal.frame }))
    };
    let mut proposals: Vec<(f64, Mistake)> = frames.iter().enumerate().filter_map(proposal_of).collect();
    proposals.sort_by(|a, b| b.0.total_cmp(&a.0));
    let closure_of = |(index, frame): (usize, &JudgedFrame)| {
        let is_false = frame.accepted_closure() == Some(Some(Verdict::False));
        let closure = frame.ranked.decision?.closure.filter(|_| is_false)?;
        Some(Mistake { frame: index, held_for: closure.frame })
    };
    let mut mistakes: Vec<Mistake> = frames.iter().enumerate().filter_map(closure_of).collect();
    let best = proposals.into_iter().map(|(_, mistake)| mistake).take(HIGHEST_FALSE_PROPOSALS);
    for mistake in best {
        if !mistakes.contains(&mistake) {
            mistakes.push(mistake);
        }
    }
    mistakes
}

/// False proposals that are drawn though none was accepted.
const HIGHEST_FALSE_PROPOSALS: usize = 5;

/// A run with everything that it depended on, so that it can be repeated.
#[derive(Serialize)]
struct Summary<'a> {
    sequence: &'a str,
    gap_frames: usize,
    model_hash: String,
    extractor: &'a str,
    words: usize,
    evidence_exponent: f64,
    settings: SystemSummary,
    #[serde(flatten)]
    report: &'a SequenceReport,
}

/// The settings in force.
#[derive(Serialize)]
#[serde(tag = "ranking", rename_all = "kebab-case")]
enum SystemSummary {
    FabMap {
        dependence: &'static str,
        new_place: &'static str,
        scorer: &'static str,
        true_positive_rate: Option<f64>,
        false_positive_rate: Option<f64>,
        new_place_prior: f64,
        even_share: f64,
        likelihood_smoothing: f64,
        closure_threshold: f64,
        verification: VerificationSummary,
        guard_frames: u64,
        looks_per_stay: u32,
        min_words: usize,
    },
    Likelihood {
        dependence: &'static str,
        new_place: &'static str,
        true_positive_rate: Option<f64>,
        false_positive_rate: Option<f64>,
    },
    TfIdf {
        threshold: Option<f64>,
    },
}

impl<'a> Summary<'a> {
    fn new(
        report: &'a SequenceReport,
        sequence: &'a Sequence,
        model: &'a Model,
        options: &SequenceOptions,
    ) -> Result<Self, EvalError> {
        let settings = match &options.system {
            System::FabMap(knobs) => SystemSummary::of(&knobs.settings(model, options.gap)?),
            System::Likelihood(knobs) => SystemSummary::of_likelihood(&knobs.settings(model, options.gap)?),
            &System::TfIdf { threshold } => SystemSummary::TfIdf { threshold },
        };
        Ok(Self {
            sequence: &sequence.name,
            gap_frames: options.gap,
            model_hash: model.hash().to_string(),
            extractor: model.extractor(),
            words: model.vocabulary().len(),
            evidence_exponent: model.evidence_exponent().value(),
            settings,
            report,
        })
    }

    fn to_json(&self) -> serde_json::Result<Vec<u8>> {
        let mut json = serde_json::to_vec_pretty(self)?;
        json.push(b'\n');
        Ok(json)
    }
}

impl SystemSummary {
    fn of_likelihood(settings: &MapperSettings) -> Self {
        let RecognizerSettings { dependence, new_place, detector, .. } = settings.recognizer;
        SystemSummary::Likelihood {
            dependence: name_of(DEPENDENCES, &dependence),
            new_place: name_of(NEW_PLACE_METHODS, &new_place),
            true_positive_rate: detector.map(|detector| detector.probability(true, true)),
            false_positive_rate: detector.map(|detector| detector.probability(true, false)),
        }
    }

    fn of(settings: &MapperSettings) -> Self {
        let MapperSettings {
            recognizer,
            closure_threshold,
            verification,
            guard_frames,
            looks_per_stay,
            min_words,
            max_speed_m_per_s: _,
            place_spacing: _,
            place_rule: _,
            odometry_noise: _,
            prior_frames: _,
        } = *settings;
        let RecognizerSettings { dependence, new_place, scorer, detector, filter } = recognizer;
        let FilterSettings { new_place_prior, even_share, likelihood_smoothing } = filter;
        SystemSummary::FabMap {
            dependence: name_of(DEPENDENCES, &dependence),
            new_place: name_of(NEW_PLACE_METHODS, &new_place),
            scorer: name_of(SCORERS, &scorer),
            true_positive_rate: detector.map(|detector| detector.probability(true, true)),
            false_positive_rate: detector.map(|detector| detector.probability(true, false)),
            new_place_prior,
            even_share,
            likelihood_smoothing,
            closure_threshold,
            verification: VerificationSummary::of(&verification),
            guard_frames,
            looks_per_stay,
            min_words,
        }
    }
}

/// The verification in force.
#[derive(Serialize)]
struct VerificationSummary {
    method: &'static str,
    min_posterior: f64,
    min_inliers: u32,
    max_rotation_rad: f64,
    max_ln_scale: f64,
    max_translation_widths: f64,
    min_evidence: f64,
    consistency_frames: u64,
}

impl VerificationSummary {
    fn of(settings: &VerificationSettings) -> Self {
        let VerificationSettings {
            method,
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence,
            consistency_frames,
        } = *settings;
        Self {
            method: name_of(VERIFICATION_METHODS, &method),
            min_posterior,
            min_inliers,
            max_rotation_rad,
            max_ln_scale,
            max_translation_widths,
            min_evidence,
            consistency_frames,
        }
    }
}

/// The system in a few words, for titles.
fn in_words(system: &System) -> String {
    match system {
        System::FabMap(knobs) => fab_map_in_words(RankingName::FabMap, knobs),
        System::Likelihood(knobs) => fab_map_in_words(RankingName::Likelihood, knobs),
        System::TfIdf { .. } => name_of(RANKINGS, &RankingName::TfIdf).to_owned(),
    }
}

fn fab_map_in_words(ranking: RankingName, knobs: &Knobs) -> String {
    let defaults = RecognizerSettings::default();
    let dependence = name_of(DEPENDENCES, &knobs.dependence.unwrap_or(defaults.dependence));
    let new_place = name_of(NEW_PLACE_METHODS, &knobs.new_place.unwrap_or(defaults.new_place));
    let verification = match knobs.verification {
        None | Some(VerificationMethod::None) => String::new(),
        Some(method) => format!(", {} verified", name_of(VERIFICATION_METHODS, &method)),
    };
    format!("{}, {dependence}, {new_place} new place{verification}", name_of(RANKINGS, &ranking))
}
