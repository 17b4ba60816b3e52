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
    table(rows)
}

/// The rows under a header, which is there even without rows.
fn table<Row: Serialize + Default>(rows: impl IntoIterator<Item = Row>) -> csv::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut rows = rows.into_iter().peekable();
    let is_empty = rows.peek().is_none();
    for row in rows.chain(is_empty.then(Row::default)) {
        writer.serialize(row)?;
    }
    let mut table = writer.into_inner().map_err(csv::IntoInnerError::into_error)?;
    if is_empty {
        table.truncate(table.iter().position(|&byte| byte == b'\n').map_or(0, |end| end + 1));
    }
    Ok(table)
}

#[derive(Default, Serialize)]
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
    table(frames.iter().enumerate().flat_map(|(index, frame)| {
        frame.ranked.candidates.iter().map(move |&RankedCandidate { frame: earlier, candidate }| {
            let Match { place, posterior, log_odds, frame: _ } = candidate.matched;
            let motion = match candidate.view.and_then(|view| view.motion) {
                Some(ViewMotion::Similarity(motion)) => Some(motion),
                Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) | None => None,
            };
            CandidateRow {
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
            }
        })
    }))
}

#[derive(Default, Serialize)]
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
    table(curve.points.iter().map(|point| {
        let OperatingPoint { threshold, true_proposals, false_proposals, neutral_proposals } = *point;
        CurveRow {
            threshold,
            recall: curve.recall(point),
            precision: point.precision(),
            true_proposals,
            false_proposals,
            neutral_proposals,
        }
    }))
}

#[derive(Default, Serialize)]
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

    #[test]
    fn a_curve_has_a_row_per_score() {
        let proposals = vec![
            JudgedProposal { score: 0.75, verdict: Verdict::True },
            JudgedProposal { score: 0.5, verdict: Verdict::False },
        ];
        let text = String::from_utf8(curve(&PrecisionRecall::sweep(proposals, 2)).unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let header = "threshold,recall,precision,true_proposals,false_proposals,neutral_proposals";
        assert_eq!(lines, [header, "0.75,0.5,1.0,1,0,0", "0.5,0.5,0.5,1,1,0"]);
        let empty = curve(&PrecisionRecall::sweep(Vec::new(), 2)).unwrap();
        assert_eq!(empty, format!("{header}\n").into_bytes());
    }
}
