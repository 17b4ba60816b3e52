//! What a run of a sequence leaves behind: files for people and programs.

use anyhow::{Context, Result};
use fabmap::model::Model;

use super::report::SequenceReport;
use super::summary::Summary;
use super::{JudgedFrame, SequenceOptions, csv_files};
use crate::calibration::Reliability;
use crate::dataset::{Sequence, Verdict};
use crate::false_pictures::{self, Mistake};
use crate::match_matrix::MatchMatrix;
use crate::precision_recall::PrecisionRecall;
use crate::{files, plots};

/// Writes all files of a run.
pub(super) fn write_all(
    report: &SequenceReport,
    sequence: &Sequence,
    model: &Model,
    frames: &[JudgedFrame],
    (curve, reliability): (&PrecisionRecall, &Reliability),
    matrix: &MatchMatrix,
    options: &SequenceOptions,
) -> Result<()> {
    let write = |name: &str, content: &[u8]| files::write(&options.out.join(name), content);
    let system = options.system.in_words();
    let title = format!("{}: {system}", sequence.name);
    write(FRAMES, &csv_files::frames(sequence, frames)?)?;
    write(CANDIDATES, &csv_files::candidates(frames, &sequence.truth)?)?;
    write(CURVE, &csv_files::curve(curve)?)?;
    write(CURVE_PLOT, plots::precision_recall_svg(&title, curve)?.as_bytes())?;
    write(RELIABILITY_PLOT, plots::reliability_svg(&title, reliability)?.as_bytes())?;
    write(MATRIX, &matrix.to_png(&sequence.truth).with_context(|| format!("{MATRIX} could not be drawn"))?)?;
    false_pictures::write_all(&options.out.join(MISTAKES), sequence, &mistakes(frames))?;
    files::write_json(&options.out.join(SUMMARY), &Summary::new(report, sequence, model, options))?;

    eprintln!("{title}; results in {}", options.out.display());
    Ok(())
}

const FRAMES: &str = "frames.csv";
const CANDIDATES: &str = "candidates.csv";
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
