//! `waypost-eval sequence`: a drive with known loops, streamed once, its proposals judged.

mod csv_files;
mod recognised;
mod report;
mod results;
mod summary;
mod system;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use fabmap::model::Model;
use topomap::log::Reason;
use waypost_vision::features::Extractor;

use self::recognised::Recognised;
pub(crate) use self::report::SequenceReport;
pub(crate) use self::system::SystemOptions;
use crate::calibration::{self, Prediction, Reliability};
use crate::dataset::{Sequence, Verdict};
use crate::match_matrix::MatchMatrix;
use crate::observing::Observed;
use crate::precision_recall::{JudgedProposal, PrecisionRecall};
use crate::ranking::{Ranked, Ranking};
use crate::timing::FrameWatch;
use crate::weights::JudgedEvidence;
use crate::{files, progress};

/// Stream a sequence with known loops once, in order, and judge the earlier frame proposed for each.
///
/// Writes precision_recall.csv and .svg, reliability.svg, match_matrix.png, frames.csv, candidates.csv and
/// summary.json.
#[derive(Args)]
pub(crate) struct SequenceOptions {
    /// Folder with images/, loops.csv and optionally ignore.csv (query_index,match_index).
    #[arg(long, value_name = "DIR")]
    sequence: PathBuf,
    /// Frames closer than this many are not loops.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..))]
    gap: u32,
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of the random choices, which the verification makes.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    system: SystemOptions,
}

/// A frame with the answer to it and what the truth says of its proposal.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JudgedFrame {
    /// The answer; its similarities have moved into the match matrix.
    pub ranked: Ranked,
    /// On the proposal; `None` without one.
    pub proposal_verdict: Option<Verdict>,
    /// On the closure that was considered; `None` without one.
    pub closure_verdict: Option<Verdict>,
}

/// A sequence that was streamed, with what came of it.
pub(crate) struct Streamed {
    /// Every frame with the answer to it.
    pub(crate) frames: Vec<JudgedFrame>,
    pub(crate) curve: PrecisionRecall,
    pub(crate) reliability: Reliability,
    pub(crate) matrix: MatchMatrix,
    pub(crate) report: SequenceReport,
}

/// Streams the sequence through the system, judges its proposals and writes what came of it.
pub(crate) fn run(options: &SequenceOptions) -> Result<SequenceReport> {
    options.system.check()?;
    let sequence = Sequence::open(&options.sequence)?;
    let (model, extractor) = files::read_model(&options.model)?;
    let system = options.system.start(&model, options.gap as usize, options.seed)?;
    files::create_folder(&options.out)?;

    let observed = sequence.images.iter().map(|path| observe(path, extractor, &model));
    let streamed = stream(&sequence, observed, options.gap, &options.system, system)?;
    results::write_all(&streamed, &sequence, &model, options)?;
    Ok(streamed.report)
}

/// Streams what the frames of a sequence show through a system, in order, and judges its proposals.
pub(crate) fn stream(
    sequence: &Sequence,
    observed: impl Iterator<Item = Result<(Observed, FrameWatch)>>,
    gap: u32,
    options: &SystemOptions,
    mut system: Box<dyn Ranking>,
) -> Result<Streamed> {
    let gap = gap as usize;
    let mut matrix = MatchMatrix::new(options.scale());
    let mut frames = Vec::with_capacity(sequence.images.len());
    let bar = progress::bar(sequence.name.clone(), sequence.images.len());
    for (index, observed) in bar.wrap_iter(observed).enumerate() {
        let (seen, watch) = observed?;
        let mut ranked = system.rank(index, seen, watch)?;
        matrix.push(&std::mem::take(&mut ranked.similarities));
        frames.push(judge(index, ranked, sequence));
    }
    bar.finish_and_clear();

    let proposals = frames.iter().filter_map(JudgedFrame::judged_proposal).collect();
    let curve = PrecisionRecall::sweep(proposals, sequence.truth.queries_with_loop(gap));
    let predictions: Vec<Prediction> = frames.iter().filter_map(JudgedFrame::prediction).collect();
    let reliability = Reliability::of(&predictions);
    let places = frames.iter().map(|frame| frame.ranked.decision.and_then(|decision| decision.place));
    let recognised = Recognised::of(places, &sequence.truth, gap);
    let on_map = system.places().map(|places| (places, recognised));
    let ece_95 = calibration::error_interval(&predictions);
    let report = SequenceReport::new(
        &frames,
        &curve,
        reliability.expected_calibration_error(),
        ece_95,
        on_map,
        options,
    );
    Ok(Streamed { frames, curve, reliability, matrix, report })
}

/// What the image of a file shows, and the watch that runs along with the frame.
pub(crate) fn observe(path: &Path, extractor: Extractor, model: &Model) -> Result<(Observed, FrameWatch)> {
    let encoded = files::read(path)?;
    let mut watch = FrameWatch::start();
    let seen = Observed::in_file(&encoded, model, extractor, &mut watch);
    Ok((seen.with_context(|| path.display().to_string())?, watch))
}

fn judge(index: usize, ranked: Ranked, sequence: &Sequence) -> JudgedFrame {
    let verdict_on = |earlier| sequence.truth.verdict(index, earlier);
    let closure = ranked.decision.and_then(|decision| decision.closure);
    JudgedFrame {
        proposal_verdict: ranked.proposal.map(|proposal| verdict_on(proposal.frame)),
        closure_verdict: closure.map(|closure| verdict_on(closure.frame)),
        ranked,
    }
}

impl JudgedFrame {
    /// The verdict on the loop closure that the map accepted here; `None` if it accepted none.
    fn accepted_closure(&self) -> Option<Option<Verdict>> {
        let accepted = self.ranked.decision.is_some_and(|decision| decision.reason == Reason::LoopClosure);
        accepted.then_some(self.closure_verdict)
    }

    /// The verdict on the proposal if its score reaches the threshold.
    fn accepted_above(&self, threshold: f64) -> Option<Option<Verdict>> {
        let accepted = self.ranked.proposal.is_some_and(|proposal| proposal.score >= threshold);
        accepted.then_some(self.proposal_verdict)
    }

    /// The probability reported for the proposal; `None` for a system without probabilities.
    fn prediction(&self) -> Option<Prediction> {
        Some(Prediction { probability: self.ranked.proposal?.probability?, verdict: self.proposal_verdict? })
    }

    /// What speaks for the proposal, if geometry had its say and the truth tells.
    pub(crate) fn judged_evidence(&self) -> Option<JudgedEvidence> {
        let proposal = self.ranked.proposal?;
        let is_right = match self.proposal_verdict? {
            Verdict::True => true,
            Verdict::False => false,
            Verdict::Neutral => return None,
        };
        let compared = self.ranked.candidates.iter().find(|compared| compared.frame == proposal.frame)?;
        let candidate = &compared.candidate;
        candidate.view?;
        let look_alikes = candidate.evidence() / candidate.look_alike_inliers;
        Some(JudgedEvidence { look_alikes, word_nats: candidate.matched.log_odds, is_right })
    }

    fn judged_proposal(&self) -> Option<JudgedProposal> {
        Some(JudgedProposal { score: self.ranked.proposal?.score, verdict: self.proposal_verdict? })
    }
}
