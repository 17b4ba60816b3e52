//! `waypost-eval calibrate`: how reliable words are, learnt from a model's own training images.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use fabmap::calibration::{self, Calibration, EvidenceExponent, LearnError, Rates};
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use serde::Serialize;

use crate::error::EvalError;
use crate::{files, progress};

/// What to calibrate.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrateOptions {
    /// The model file.
    pub model: PathBuf,
    /// Fixed or learned rates.
    pub detector: DetectorChoice,
    /// The model file to write.
    pub out: PathBuf,
}

/// Where the detector's rates come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DetectorChoice {
    /// [`DetectorModel::default`], with likelihoods as they are. It asks nothing of the training images; the
    /// others need neighbours that overlap.
    Fixed,
    /// [`DetectorModel::default`], with the exponent learnt that makes its likelihoods comparable.
    Tempered,
    /// Rates and exponent learnt together; typical ones where too few training images overlap.
    #[default]
    Learned,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrateReport {
    /// p(z=1|e=1).
    pub true_positive_rate: f64,
    /// p(z=1|e=0).
    pub false_positive_rate: f64,
    /// What likelihoods are raised to.
    pub evidence_exponent: f64,
    /// Pairs of overlapping training images that it was learnt from; null if nothing was.
    pub pairs: Option<usize>,
    /// Mean of -ln p(what is right) over staged revisits and new places, in nats.
    pub loss_nats: Option<f64>,
    /// Hash of the model's content, its name.
    pub model_hash: String,
}

/// Writes the model anew over the same words, with other rates and exponent.
///
/// # Errors
/// [`EvalError`]; no file is written then.
pub fn run(options: &CalibrateOptions) -> Result<CalibrateReport, EvalError> {
    let (model, _) = files::read_model(&options.model)?;
    let (model, learnt) = calibrated(&model, options.detector)?;
    files::write(&options.out, &model.to_bytes())?;
    let report = CalibrateReport {
        true_positive_rate: model.detector().probability(true, true),
        false_positive_rate: model.detector().probability(true, false),
        evidence_exponent: model.evidence_exponent().value(),
        pairs: learnt.map(|learnt| learnt.pairs),
        loss_nats: learnt.map(|learnt| learnt.loss_nats),
        model_hash: model.hash().to_string(),
    };
    eprint!("{}", report.table(&options.out));
    Ok(report)
}

/// The model over the same words as `choice` has it, and what was learnt for it.
///
/// # Errors
/// [`EvalError::Calibration`] if only the exponent was to be learnt and too few training images overlap.
pub fn calibrated(model: &Model, choice: DetectorChoice) -> Result<(Model, Option<Calibration>), EvalError> {
    let fixed = DetectorModel::default();
    let bar = progress::bar("detector", PER_MILLE);
    let mut observer = |fraction| {
        bar.set_position((fraction * PER_MILLE as f64) as u64);
        ControlFlow::Continue(())
    };
    let calibrated = match choice {
        DetectorChoice::Fixed => (model.recalibrated(fixed, EvidenceExponent::NONE), None),
        DetectorChoice::Tempered => {
            let learnt = calibration::learn(model, Rates::Fixed(fixed), &mut observer)?;
            (model.recalibrated(learnt.detector, learnt.exponent), Some(learnt))
        }
        DetectorChoice::Learned => match calibration::calibrate(model, &mut observer) {
            ControlFlow::Continue(calibrated) => calibrated,
            ControlFlow::Break(()) => return Err(LearnError::Cancelled.into()),
        },
    };
    bar.finish_and_clear();
    Ok(calibrated)
}

const PER_MILLE: usize = 1000;

impl CalibrateReport {
    fn table(&self, out: &Path) -> String {
        let learnt = match (self.pairs, self.loss_nats) {
            (Some(pairs), Some(loss)) => format!("{pairs} overlapping pairs, loss {loss:.4} nats"),
            (Some(_) | None, _) => "none of its images, too few of which overlap".to_owned(),
        };
        format!(
            "model        {}\nfile         {}\np(z=1|e=1)   {}\np(z=1|e=0)   {}\nexponent     {:.4}\nlearnt from  {learnt}\n",
            self.model_hash,
            out.display(),
            self.true_positive_rate,
            self.false_positive_rate,
            self.evidence_exponent,
        )
    }
}
