//! The settings that a run was made with, beside its measures.

use fabmap::model::Model;
use serde::Serialize;

use super::SequenceOptions;
use super::report::SequenceReport;
use super::system::RankingName;
use crate::choices::own_name;
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
    ranking: String,
    threshold: Option<f64>,
    /// All settings in force, by their names in the code; null for a system that has none.
    settings: Option<String>,
    #[serde(flatten)]
    report: &'a SequenceReport,
}

impl<'a> Summary<'a> {
    pub(super) fn new(
        report: &'a SequenceReport,
        sequence: &'a Sequence,
        model: &'a Model,
        options: &'a SequenceOptions,
    ) -> Self {
        let system = &options.system;
        let settings = || system.settings(options.gap as usize);
        Self {
            sequence: &sequence.name,
            gap_frames: options.gap,
            model_hash: model.hash().to_string(),
            extractor: model.extractor(),
            words: model.vocabulary().len(),
            evidence_exponent: model.evidence_exponent().value(),
            ranking: own_name(&system.ranking),
            threshold: system.threshold,
            settings: match system.ranking {
                RankingName::FabMap => Some(format!("{:?}", settings())),
                RankingName::Likelihood => Some(format!("{:?}", settings().recognizer)),
                RankingName::TfIdf => None,
            },
            report,
        }
    }
}
