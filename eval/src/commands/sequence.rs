//! `waypost-eval sequence`: a drive with known loops, streamed once, its proposals judged.

mod csv_files;
mod report;

pub use report::SequenceReport;

use std::path::{Path, PathBuf};

use fabmap::detector::DetectorModel;
use fabmap::likelihood::Dependence;
use fabmap::model::Model;
use fabmap::new_place::NewPlaceMethod;
use fabmap::observation::Observation;
use fabmap::recognizer::Scorer;
use topomap::event::Reason;
use topomap::mapper::MapperSettings;
use topomap::verification::VerificationMethod;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, Features};

use crate::calibration::{Prediction, Reliability};
use crate::dataset::{Sequence, Verdict};
use crate::error::EvalError;
use crate::match_matrix::{MatchMatrix, Scale};
use crate::precision_recall::{JudgedProposal, PrecisionRecall};
use crate::ranking::{FabMap, LikelihoodRanking, Ranked, Ranking, TfIdfRanking};
use crate::timing::FrameWatch;
use crate::{files, progress};

/// What to run, on what.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceOptions {
    /// Folder with `images/`, `loops.csv` and perhaps `ignore.csv`.
    pub sequence: PathBuf,
    /// Frames closer than this in time are not loops; at least 1.
    pub gap: usize,
    /// The model file.
    pub model: PathBuf,
    /// The system to judge.
    pub system: System,
    /// Seed of the random choices.
    pub seed: u64,
    /// Folder for the results.
    pub out: PathBuf,
}

/// A system to judge.
#[derive(Clone, Debug, PartialEq)]
pub enum System {
    /// FAB-MAP over a growing map, as the server runs it.
    FabMap(Knobs),
    /// FAB-MAP's likelihood alone, without map, motion and filter.
    Likelihood(Knobs),
    /// The baseline: every earlier frame by the cosine of its tf-idf vector.
    TfIdf {
        /// Cosine from which a proposal counts as accepted; `None` accepts none.
        threshold: Option<f64>,
    },
}

/// What can be set of FAB-MAP; `None` keeps the default, which the settings themselves have.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Knobs {
    /// See [`MapperSettings::closure_threshold`].
    pub closure_threshold: Option<f64>,
    /// How closures are verified.
    pub verification: Option<VerificationMethod>,
    /// See [`topomap::verification::VerificationSettings::min_evidence`].
    pub min_evidence: Option<f64>,
    /// See [`topomap::verification::VerificationSettings::consistency_frames`].
    pub consistency_frames: Option<u64>,
    /// Chow-Liu tree or naive Bayes.
    pub dependence: Option<Dependence>,
    /// Mean field or sampled.
    pub new_place: Option<NewPlaceMethod>,
    /// Inverted index or dense.
    pub scorer: Option<Scorer>,
    /// p(z=1|e=1), instead of the model's.
    pub true_positive_rate: Option<f64>,
    /// p(z=1|e=0), instead of the model's.
    pub false_positive_rate: Option<f64>,
    /// p(new).
    pub new_place_prior: Option<f64>,
    /// ε.
    pub even_share: Option<f64>,
    /// σ.
    pub likelihood_smoothing: Option<f64>,
}

/// A frame with the answer to it and what the truth says of its proposal.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgedFrame {
    /// The answer; its similarities have moved into the match matrix.
    pub ranked: Ranked,
    /// On the proposal; `None` without one.
    pub proposal_verdict: Option<Verdict>,
    /// On the closure that was considered; `None` without one.
    pub closure_verdict: Option<Verdict>,
}

/// Streams the sequence through the system, judges its proposals and writes what came of it.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &SequenceOptions) -> Result<SequenceReport, EvalError> {
    Ok(run_with_curve(options)?.0)
}

/// As [`run`]; also gives the precision-recall curve.
///
/// # Errors
/// [`EvalError`].
pub fn run_with_curve(options: &SequenceOptions) -> Result<(SequenceReport, PrecisionRecall), EvalError> {
    let sequence = Sequence::open(&options.sequence)?;
    let (model, extractor) = files::read_model(&options.model)?;
    let (mut system, scale) = start(options, &model)?;
    files::create_folder(&options.out)?;

    let mut matrix = MatchMatrix::new(scale);
    let mut frames = Vec::with_capacity(sequence.images.len());
    let bar = progress::bar("frames", sequence.images.len());
    for (index, image) in bar.wrap_iter(sequence.images.iter().enumerate()) {
        let mut ranked = recognise(index, image, extractor, &model, options, system.as_mut())?;
        matrix.push(&std::mem::take(&mut ranked.similarities));
        frames.push(judge(index, ranked, &sequence));
    }
    bar.finish_and_clear();

    let proposals = frames.iter().filter_map(JudgedFrame::judged_proposal).collect();
    let curve = PrecisionRecall::sweep(proposals, sequence.truth.queries_with_loop(options.gap));
    let predictions: Vec<Prediction> = frames.iter().filter_map(JudgedFrame::prediction).collect();
    let reliability = Reliability::of(&predictions);
    let report = SequenceReport::new(&frames, &curve, &reliability, system.places(), options);
    report::write_all(&report, &sequence, &model, &frames, (&curve, &reliability), &matrix, options)?;
    Ok((report, curve))
}

fn start(options: &SequenceOptions, model: &Model) -> Result<(Box<dyn Ranking>, Scale), EvalError> {
    Ok(match &options.system {
        System::FabMap(knobs) => {
            let settings = knobs.settings(model, options.gap)?;
            (Box::new(FabMap::new(model, settings, options.seed)?), Scale::Posterior)
        }
        System::Likelihood(knobs) => {
            let settings = knobs.settings(model, options.gap)?.recognizer;
            (Box::new(LikelihoodRanking::new(model, settings, options.gap)?), Scale::Posterior)
        }
        System::TfIdf { .. } => (Box::new(TfIdfRanking::new(model, options.gap)), Scale::Cosine),
    })
}

/// One frame, from the encoded image to the answer.
fn recognise(
    index: usize,
    path: &Path,
    extractor: Extractor,
    model: &Model,
    options: &SequenceOptions,
    system: &mut dyn Ranking,
) -> Result<Ranked, EvalError> {
    let encoded = files::read(path)?;
    let mut watch = FrameWatch::start();
    let (image, features) = extractor
        .extract_encoded(&encoded)
        .map_err(|reason| EvalError::Image { path: path.to_owned(), reason })?;
    watch.extracted();
    let words = model
        .vocabulary()
        .words(&features.descriptors)
        .map_err(|reason| EvalError::ForeignVocabulary { path: options.model.clone(), reason })?;
    let vocabulary_len = model.vocabulary().len();
    let observation = Observation::from_words(words.iter().copied(), vocabulary_len)
        .unwrap_or_else(|_| unreachable!("a vocabulary's own words"));
    watch.quantized();
    let Features { keypoints, descriptors } = features;
    let size_px = (image.width(), image.height());
    let features = FeatureRecord::new(size_px, keypoints, words, Some(descriptors))
        .unwrap_or_else(|_| unreachable!("a keypoint, a word and a descriptor for each feature"));
    system.rank(index, observation, features, watch)
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
        let (proposal, verdict) = (self.ranked.proposal?, self.proposal_verdict?);
        Some(Prediction { probability: proposal.probability?, verdict })
    }

    fn judged_proposal(&self) -> Option<JudgedProposal> {
        let (proposal, verdict) = (self.ranked.proposal?, self.proposal_verdict?);
        Some(JudgedProposal { score: proposal.score, verdict })
    }
}

impl Knobs {
    /// The mapper's settings with these knobs turned; frames closer than `gap` are never loops.
    ///
    /// # Errors
    /// [`EvalError::Detector`] if a rate is out of range. The mapper checks the others.
    pub fn settings(&self, model: &Model, gap: usize) -> Result<MapperSettings, EvalError> {
        let Self {
            closure_threshold,
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            even_share,
            likelihood_smoothing,
        } = *self;
        let mut settings = MapperSettings { guard_frames: gap as u64, ..MapperSettings::default() };
        set(&mut settings.closure_threshold, closure_threshold);
        if let Some(method) = verification {
            settings.verification.method = method;
        }
        set(&mut settings.verification.min_evidence, min_evidence);
        set(&mut settings.verification.consistency_frames, consistency_frames);
        set(&mut settings.recognizer.dependence, dependence);
        set(&mut settings.recognizer.new_place, new_place);
        set(&mut settings.recognizer.scorer, scorer);
        set(&mut settings.recognizer.filter.new_place_prior, new_place_prior);
        set(&mut settings.recognizer.filter.even_share, even_share);
        set(&mut settings.recognizer.filter.likelihood_smoothing, likelihood_smoothing);
        let rate = |given: Option<f64>, exists| given.unwrap_or(model.detector().probability(true, exists));
        let detector = DetectorModel::new(rate(true_positive_rate, true), rate(false_positive_rate, false))?;
        settings.recognizer.detector = Some(detector);
        Ok(settings)
    }
}

fn set<T>(setting: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *setting = given;
    }
}
