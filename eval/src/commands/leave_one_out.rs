//! `waypost-eval leave-one-out`: how the rule for closures does on a sequence that its weights never saw.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use fabmap::model::Model;
use rayon::prelude::*;
use serde::Serialize;
use topomap::evidence::ProbabilityWeights;
use waypost_vision::features::Extractor;

use super::sequence::{JudgedFrame, SequenceReport, Streamed, SystemOptions, observe, stream};
use super::train::{self, TrainOptions};
use crate::dataset::Sequence;
use crate::files;
use crate::observing::Observed;
use crate::timing::FrameWatch;
use crate::weights::{self, JudgedEvidence};

/// Fit the weights of a closure's probability to all development sequences but one and judge that one, for each.
///
/// Models are trained from other places. Writes leave_one_out.json, and the models.
#[derive(Args)]
pub(crate) struct LeaveOneOutOptions {
    /// Folder of the data: the four sequences, and the images that models are trained from, each in a folder of its
    /// own name.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder for the result; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// A sequence, how far apart its loops are, and the images of other places that its model is trained from.
struct Drive {
    folder: &'static str,
    gap_frames: u32,
    trained_on: TrainedOn,
}

/// Images that a model is trained from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum TrainedOn {
    Indoors,
    Outdoors,
}

const DRIVES: [Drive; 4] = [
    Drive { folder: "ietower_revisit_dev", gap_frames: 30, trained_on: TrainedOn::Indoors },
    Drive { folder: "michigan_12months", gap_frames: 5, trained_on: TrainedOn::Outdoors },
    Drive { folder: "qut_corridor", gap_frames: 20, trained_on: TrainedOn::Indoors },
    Drive { folder: "gardenspoint_day", gap_frames: 20, trained_on: TrainedOn::Outdoors },
];

/// Words and seed of the models.
const WORDS: u32 = 5000;
const SEED: u64 = 1;

/// The result.
#[derive(Serialize)]
pub(crate) struct LeaveOneOutReport {
    /// Fitted to all sequences: what the default is made from.
    weights_of_all: Weights,
    /// Each sequence, by weights that were fitted to the other three.
    left_out: Vec<SequenceResult>,
    /// Each sequence by the default weights, which were fitted to it among others.
    default: Vec<SequenceResult>,
}

/// One sequence as it was judged.
#[derive(Serialize)]
struct SequenceResult {
    sequence: String,
    #[serde(flatten)]
    weights: Weights,
    #[serde(flatten)]
    report: SequenceReport,
}

/// [`ProbabilityWeights`].
#[derive(Serialize)]
struct Weights {
    offset_nats: f64,
    per_look_alike_nats: f64,
    per_word_nat: f64,
}

/// What the frames of a sequence show, for as many runs as are wanted.
struct Prepared {
    sequence: Sequence,
    gap_frames: u32,
    trained_on: TrainedOn,
    observed: Vec<Observed>,
}

/// The models, by what they were trained on.
struct Models {
    indoors: (Model, Extractor),
    outdoors: (Model, Extractor),
}

/// Trains the models, and judges each sequence by the weights that the others give.
pub(crate) fn run(options: &LeaveOneOutOptions) -> Result<LeaveOneOutReport> {
    files::create_folder(&options.out)?;
    let models = Models::train(options)?;
    let prepared =
        DRIVES.iter().map(|drive| drive.prepare(&options.data, &models)).collect::<Result<Vec<_>>>()?;
    let by_default = run_all(&prepared, &models, |_| ProbabilityWeights::default())?;
    let evidence: Vec<Vec<JudgedEvidence>> = by_default.iter().map(evidence_of).collect();
    let left_out = run_all(&prepared, &models, |index| {
        let others = evidence.iter().enumerate().filter(|(other, _)| *other != index);
        weights::fit(&others.map(|(_, judged)| judged.as_slice()).collect::<Vec<_>>())
    })?;
    let all: Vec<&[JudgedEvidence]> = evidence.iter().map(Vec::as_slice).collect();
    let report = LeaveOneOutReport {
        weights_of_all: weights::fit(&all).into(),
        left_out: left_out.into_iter().map(SequenceResult::from).collect(),
        default: by_default.into_iter().map(SequenceResult::from).collect(),
    };
    files::write_json(&options.out.join("leave_one_out.json"), &report)?;
    Ok(report)
}

/// A sequence that was run with weights of its own.
struct Judged {
    sequence: String,
    weights: ProbabilityWeights,
    streamed: Streamed,
}

/// Runs each sequence by the weights for its number, on as many threads as there are.
fn run_all(
    prepared: &[Prepared],
    models: &Models,
    weights: impl Fn(usize) -> ProbabilityWeights + Sync,
) -> Result<Vec<Judged>> {
    let run = |(index, prepared): (usize, &Prepared)| prepared.run(models, weights(index));
    prepared.par_iter().enumerate().map(run).collect()
}

fn evidence_of(judged: &Judged) -> Vec<JudgedEvidence> {
    judged.streamed.frames.iter().filter_map(JudgedFrame::judged_evidence).collect()
}

impl Models {
    fn train(LeaveOneOutOptions { data, out }: &LeaveOneOutOptions) -> Result<Self> {
        let (indoors, outdoors) = (data.join("train_ietower"), data.join("train_outdoor"));
        let train = |images, name| {
            let options = TrainOptions::of_images(images, WORDS, SEED, out.join(name));
            train::run(&options)?;
            files::read_model(&out.join(name))
        };
        Ok(Self {
            indoors: train(vec![indoors.clone()], "indoor.waypost")?,
            outdoors: train(vec![outdoors, indoors], "outdoor.waypost")?,
        })
    }

    fn of(&self, trained_on: TrainedOn) -> &(Model, Extractor) {
        match trained_on {
            TrainedOn::Indoors => &self.indoors,
            TrainedOn::Outdoors => &self.outdoors,
        }
    }
}

impl Drive {
    fn prepare(&self, data: &Path, models: &Models) -> Result<Prepared> {
        let sequence = Sequence::open(&data.join(self.folder))?;
        let (model, extractor) = models.of(self.trained_on);
        let seen = |path: &PathBuf| Ok(observe(path, *extractor, model)?.0);
        let observed = sequence.images.par_iter().map(seen).collect::<Result<_>>()?;
        Ok(Prepared { sequence, gap_frames: self.gap_frames, trained_on: self.trained_on, observed })
    }
}

impl Prepared {
    fn run(&self, models: &Models, weights: ProbabilityWeights) -> Result<Judged> {
        let system = SystemOptions::with_weights(weights);
        let ranking = system.start(&models.of(self.trained_on).0, self.gap_frames as usize, 0)?;
        let observed = self.observed.iter().map(|seen| Ok((seen.clone(), FrameWatch::start())));
        let streamed = stream(&self.sequence, observed, self.gap_frames, &system, ranking)?;
        Ok(Judged { sequence: self.sequence.name.clone(), weights, streamed })
    }
}

impl From<Judged> for SequenceResult {
    fn from(Judged { sequence, weights, streamed }: Judged) -> Self {
        Self { sequence, weights: weights.into(), report: streamed.report }
    }
}

impl From<ProbabilityWeights> for Weights {
    fn from(weights: ProbabilityWeights) -> Self {
        let ProbabilityWeights { offset_nats, per_look_alike_nats, per_word_nat } = weights;
        Self { offset_nats, per_look_alike_nats, per_word_nat }
    }
}
