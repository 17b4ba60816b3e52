//! The settings that a run was made with, beside its measures.

use anyhow::Result;
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::RecognizerSettings;
use serde::Serialize;
use serde_json::{Value, json};
use topomap::evidence::{ProbabilityWeights, VerificationSettings};
use topomap::settings::MapperSettings;

use super::SequenceOptions;
use super::report::SequenceReport;
use super::system::RankingName;
use crate::choices::{DEPENDENCES, NEW_PLACE_METHODS, SCORERS, VERIFICATION_METHODS, name_of};
use crate::dataset::Sequence;

/// A run with everything that it depended on, so that it can be repeated.
#[derive(Serialize)]
pub(super) struct Summary<'a> {
    sequence: &'a str,
    gap_frames: u32,
    model_hash: String,
    extractor: &'a str,
    words: usize,
    evidence_exponent: f64,
    /// The settings in force.
    settings: Value,
    #[serde(flatten)]
    report: &'a SequenceReport,
}

impl<'a> Summary<'a> {
    pub(super) fn new(
        report: &'a SequenceReport,
        sequence: &'a Sequence,
        model: &'a Model,
        options: &SequenceOptions,
    ) -> Result<Self> {
        let settings = || options.system.settings(model, options.gap as usize);
        Ok(Self {
            sequence: &sequence.name,
            gap_frames: options.gap,
            model_hash: model.hash().to_string(),
            extractor: model.extractor(),
            words: model.vocabulary().len(),
            evidence_exponent: model.evidence_exponent().value(),
            settings: match options.system.ranking {
                RankingName::FabMap => of_fab_map(&settings()?),
                RankingName::Likelihood => of_likelihood(&settings()?.recognizer),
                RankingName::TfIdf => json!({ "ranking": "tf-idf", "threshold": options.system.threshold }),
            },
            report,
        })
    }
}

fn rate(detector: Option<DetectorModel>, exists: bool) -> Option<f64> {
    detector.map(|detector| detector.probability(true, exists))
}

fn of_likelihood(settings: &RecognizerSettings) -> Value {
    let RecognizerSettings { dependence, new_place, detector, .. } = *settings;
    json!({
        "ranking": "likelihood",
        "dependence": name_of(DEPENDENCES, &dependence),
        "new_place": name_of(NEW_PLACE_METHODS, &new_place),
        "true_positive_rate": rate(detector, true),
        "false_positive_rate": rate(detector, false),
    })
}

fn of_fab_map(settings: &MapperSettings) -> Value {
    let MapperSettings {
        recognizer,
        closure_threshold,
        verification,
        guard_frames,
        // Images without odometry are counted either way.
        guard_measure: _,
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
    json!({
        "ranking": "fab-map",
        "dependence": name_of(DEPENDENCES, &dependence),
        "new_place": name_of(NEW_PLACE_METHODS, &new_place),
        "scorer": name_of(SCORERS, &scorer),
        "true_positive_rate": rate(detector, true),
        "false_positive_rate": rate(detector, false),
        "new_place_prior": new_place_prior,
        "even_share": even_share,
        "likelihood_smoothing": likelihood_smoothing,
        "closure_threshold": closure_threshold,
        "verification": of_verification(&verification),
        "guard_frames": guard_frames,
        "looks_per_stay": looks_per_stay,
        "min_words": min_words,
    })
}

fn of_verification(settings: &VerificationSettings) -> Value {
    let VerificationSettings {
        method,
        min_posterior,
        min_inliers,
        max_rotation_rad,
        max_ln_scale,
        max_translation_widths,
        weights: ProbabilityWeights { offset_nats, per_look_alike_nats, per_word_nat },
        consistency_frames,
    } = *settings;
    json!({
        "method": name_of(VERIFICATION_METHODS, &method),
        "min_posterior": min_posterior,
        "min_inliers": min_inliers,
        "max_rotation_rad": max_rotation_rad,
        "max_ln_scale": max_ln_scale,
        "max_translation_widths": max_translation_widths,
        "probability_weights": [offset_nats, per_look_alike_nats, per_word_nat],
        "consistency_frames": consistency_frames,
    })
}
