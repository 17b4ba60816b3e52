//! The tables of a run, as CSV with a header.

use serde::Serialize;
use topomap::evidence::{Match, ViewMotion};

use super::JudgedFrame;
use crate::choices::{REASONS, VERDICTS, name_of};
use crate::dataset::{Sequence, Truth};
use crate::precision_recall::{OperatingPoint, PrecisionRecall};
use crate::ranking::RankedCandidate;

/// One row per frame; the same input gives the same bytes.
pub(super) fn frames(sequence: &Sequence, frames: &[JudgedFrame]) -> csv::Result<Vec<u8>> {
    let rows = frames.iter().zip(&sequence.images).enumerate().map(|(index, (frame, image))| {
        let JudgedFrame { ranked, proposal_verdict, closure_verdict } = frame;
        let decision = ranked.decision.as_ref();
        FrameRow {
            index,
            image: image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            words: ranked.words,
            reason: decision.map_or("", |decision| name_of(REASONS, &decision.reason)),
            place: decision.and_then(|decision| decision.place),
            posterior: decision.map(|decision| decision.posterior),
            p_new: decision.map(|decision| decision.new_place_posterior),
            proposal_frame: ranked.proposal.map(|proposal| proposal.frame),
            proposal_score: ranked.proposal.map(|proposal| proposal.score),
            proposal_posterior: ranked.proposal.and_then(|proposal| proposal.posterior),
            proposal_probability: ranked.proposal.and_then(|proposal| proposal.probability),
            verdict: name_of(VERDICTS, proposal_verdict),
            closure_frame: decision.and_then(|decision| decision.closure).map(|closure| closure.frame),
            closure_verdict: name_of(VERDICTS, closure_verdict),
        }
    });
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row)?;
    }
    writer.into_inner().map_err(|error| error.into_error().into())
}

#[derive(Serialize)]
struct FrameRow {
    index: usize,
    image: String,
    words: usize,
    reason: &'static str,
    place: Option<u32>,
    posterior: Option<f64>,
    p_new: Option<f64>,
    proposal_frame: Option<usize>,
    proposal_score: Option<f64>,
    proposal_posterior: Option<f64>,
    proposal_probability: Option<f64>,
    verdict: &'static str,
    closure_frame: Option<usize>,
    closure_verdict: &'static str,
}

/// One row per earlier frame that a frame was compared with.
pub(super) fn candidates(frames: &[JudgedFrame], truth: &Truth) -> csv::Result<Vec<u8>> {
    // The header also where nothing was compared.
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    writer.write_record(CANDIDATE_COLUMNS)?;
    for (index, frame) in frames.iter().enumerate() {
        for &RankedCandidate { frame: earlier, candidate } in &frame.ranked.candidates {
            let Match { place, posterior, log_odds, frame: _ } = candidate.matched;
            let motion = match candidate.view.and_then(|view| view.motion) {
                Some(ViewMotion::Similarity(motion)) => Some(motion),
                Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) | None => None,
            };
            writer.serialize(CandidateRow {
                index,
                frame: earlier,
                place,
                posterior,
                log_odds_nats: log_odds,
                matches: candidate.view.map(|view| view.matches),
                inliers: candidate.view.map(|view| view.inliers),
                distinct_inliers: candidate.view.map(|view| view.distinct_inliers),
                own_evidence_inliers: candidate.own_evidence(),
                support_inliers: candidate.support,
                evidence_inliers: candidate.evidence(),
                look_alike_inliers: candidate.look_alike_inliers,
                probability: candidate.probability(),
                rotation_rad: motion.map(|motion| motion.rotation_rad),
                ln_scale: motion.map(|motion| motion.ln_scale),
                shift_x_widths: motion.map(|motion| motion.translation_widths[0]),
                shift_y_widths: motion.map(|motion| motion.translation_widths[1]),
                verdict: name_of(VERDICTS, &Some(truth.verdict(index, earlier))),
            })?;
        }
    }
    writer.into_inner().map_err(|error| error.into_error().into())
}

const CANDIDATE_COLUMNS: [&str; 18] = [
    "index",
    "frame",
    "place",
    "posterior",
    "log_odds_nats",
    "matches",
    "inliers",
    "distinct_inliers",
    "own_evidence_inliers",
    "support_inliers",
    "evidence_inliers",
    "look_alike_inliers",
    "probability",
    "rotation_rad",
    "ln_scale",
    "shift_x_widths",
    "shift_y_widths",
    "verdict",
];

/// Fields in the order of [`CANDIDATE_COLUMNS`].
#[derive(Serialize)]
struct CandidateRow {
    index: usize,
    frame: usize,
    place: u32,
    posterior: f64,
    log_odds_nats: f64,
    matches: Option<u32>,
    inliers: Option<u32>,
    distinct_inliers: Option<u32>,
    own_evidence_inliers: f64,
    support_inliers: f64,
    evidence_inliers: f64,
    look_alike_inliers: f64,
    probability: f64,
    rotation_rad: Option<f64>,
    ln_scale: Option<f64>,
    shift_x_widths: Option<f64>,
    shift_y_widths: Option<f64>,
    verdict: &'static str,
}

/// One row per operating point, highest threshold first.
pub(super) fn curve(curve: &PrecisionRecall) -> csv::Result<Vec<u8>> {
    // The header also where there are no rows.
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    writer.write_record(CURVE_COLUMNS)?;
    for point in &curve.points {
        let OperatingPoint { threshold, true_proposals, false_proposals, neutral_proposals } = *point;
        writer.serialize(CurveRow {
            threshold,
            recall: curve.recall(point),
            precision: point.precision(),
            true_proposals,
            false_proposals,
            neutral_proposals,
        })?;
    }
    writer.into_inner().map_err(|error| error.into_error().into())
}

const CURVE_COLUMNS: [&str; 6] =
    ["threshold", "recall", "precision", "true_proposals", "false_proposals", "neutral_proposals"];

/// Fields in the order of [`CURVE_COLUMNS`].
#[derive(Serialize)]
struct CurveRow {
    threshold: f64,
    recall: Option<f64>,
    precision: f64,
    true_proposals: usize,
    false_proposals: usize,
    neutral_proposals: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Verdict;
    use crate::precision_recall::JudgedProposal;

    /// Where rows carry their own header, it is the one that is written.
    #[test]
    fn columns_are_the_fields() {
        let row = CurveRow {
            threshold: 0.5,
            recall: None,
            precision: 1.0,
            true_proposals: 0,
            false_proposals: 0,
            neutral_proposals: 2,
        };
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.serialize(&row).unwrap();
        let with_own_header = writer.into_inner().unwrap();
        assert!(with_own_header.starts_with(CURVE_COLUMNS.join(",").as_bytes()));
    }

    #[test]
    fn a_curve_has_a_row_per_score() {
        let proposals = vec![
            JudgedProposal { score: 0.75, verdict: Verdict::True },
            JudgedProposal { score: 0.5, verdict: Verdict::False },
        ];
        let text = String::from_utf8(curve(&PrecisionRecall::sweep(proposals, 2)).unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines, [CURVE_COLUMNS.join(",").as_str(), "0.75,0.5,1.0,1,0,0", "0.5,0.5,0.5,1,1,0"]);
        let empty = curve(&PrecisionRecall::sweep(Vec::new(), 2)).unwrap();
        assert_eq!(empty, format!("{}\n", CURVE_COLUMNS.join(",")).into_bytes());
    }
}
