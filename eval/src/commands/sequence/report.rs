//! The measures of a run.

use serde::Serialize;

use super::JudgedFrame;
use super::recognised::Recognised;
use super::system::{RankingName, SystemOptions};
use crate::dataset::Verdict;
use crate::precision_recall::PrecisionRecall;
use crate::timing::StageTimes;

/// The measures of one run; fractions lie in 0 to 1 and are null if no frame has a loop.
#[derive(Serialize)]
pub(crate) struct SequenceReport {
    /// Frames streamed.
    pub frames: usize,
    /// Frames that have a loop.
    pub queries_with_loop: usize,
    pub recall_at_100_precision: Option<f64>,
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
    /// Frames put to a place known from before that holds a true match: what a robot gets; null for a system without a
    /// map.
    pub recognised: Option<usize>,
    /// Frames put to one that holds none.
    pub recognised_wrongly: Option<usize>,
    /// Expected calibration error of the probability reported for the proposal; null for a system
    /// without probabilities. See [`crate::calibration::Reliability`].
    pub ece: Option<f64>,
    /// Where 95 % of its values lie when frames are drawn anew; see [`crate::calibration::error_interval`].
    pub ece_95: Option<[f64; 2]>,
    /// Median wall time per frame and stage, in milliseconds.
    pub ms_p50: StageTimes,
}

impl SequenceReport {
    pub(super) fn new(
        frames: &[JudgedFrame],
        curve: &PrecisionRecall,
        ece: Option<f64>,
        ece_95: Option<[f64; 2]>,
        on_map: Option<(usize, Recognised)>,
        system: &SystemOptions,
    ) -> Self {
        let above = |threshold| frames.iter().filter_map(|frame| frame.accepted_above(threshold)).collect();
        let closures: Option<Vec<Option<Verdict>>> = match system.ranking {
            RankingName::FabMap => Some(frames.iter().filter_map(JudgedFrame::accepted_closure).collect()),
            RankingName::Likelihood => {
                system.threshold.map(|threshold| above((threshold / (1.0 - threshold)).ln()))
            }
            RankingName::TfIdf => system.threshold.map(above),
        };
        let is_false = |verdict: &&Option<Verdict>| **verdict == Some(Verdict::False);
        let times: Vec<StageTimes> = frames.iter().map(|frame| frame.ranked.times).collect();
        Self {
            frames: frames.len(),
            queries_with_loop: curve.queries_with_loop,
            recall_at_100_precision: curve.recall_at_100_precision(),
            average_precision: curve.average_precision(),
            false_positives: curve.unthresholded().map_or(0, |all| all.false_proposals),
            true_positives: curve.unthresholded().map_or(0, |all| all.true_proposals),
            places: on_map.map(|(places, _)| places),
            loop_closures: closures.as_ref().map(Vec::len),
            loop_closures_false: closures.as_ref().map(|closures| closures.iter().filter(is_false).count()),
            recognised: on_map.map(|(_, recognised)| recognised.right),
            recognised_wrongly: on_map.map(|(_, recognised)| recognised.wrong),
            ece,
            ece_95,
            ms_p50: StageTimes::medians(&times),
        }
    }
}
