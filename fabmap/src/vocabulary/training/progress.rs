//! How far training has come, and stopping it.

use std::ops::ControlFlow;

/// How far training has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingProgress {
    /// What is being done.
    pub stage: TrainingStage,
    /// Part of the whole that is done, 0 to 1; it never falls.
    pub fraction: f64,
}

/// The stages of training, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrainingStage {
    /// Choosing the first centres.
    Seeding,
    /// An iteration of Lloyd's algorithm, over all words or, in a large vocabulary, over its cells.
    Iteration {
        /// The iteration; 0 assigns descriptors to the first centres.
        iteration: u32,
        /// Iterations at most.
        iterations: u32,
    },
    /// Dividing the cells of a large vocabulary into words.
    Cells {
        /// Cells done.
        trained: u32,
        /// Cells in all.
        cells: u32,
    },
}

/// How far one clustering has come.
#[derive(Clone, Copy, Debug)]
pub(super) enum Step {
    /// Choosing the first centres.
    Seeding { fraction: f64 },
    /// Assigning rows; iteration 0 assigns to the first centres.
    Iteration { iteration: u32, fraction: f64 },
}

/// How far the training of a search tree has come.
#[derive(Clone, Copy, Debug)]
pub(super) enum TreeStep {
    /// Clustering into cells.
    Cells(Step),
    /// Clustering each cell into words.
    Words { trained: u32, cells: u32 },
}

/// The observer asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cancelled;

impl Cancelled {
    pub(super) fn unless_continued(answer: ControlFlow<()>) -> Result<(), Self> {
        match answer {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Self),
        }
    }
}

impl Step {
    /// Seeding counts as one iteration of those at most, assigning to the first centres as another.
    pub(super) fn progress(self, iterations: u32) -> TrainingProgress {
        let passes = f64::from(iterations) + 2.0;
        match self {
            Self::Seeding { fraction } => {
                TrainingProgress { stage: TrainingStage::Seeding, fraction: fraction / passes }
            }
            Self::Iteration { iteration, fraction } => TrainingProgress {
                stage: TrainingStage::Iteration { iteration, iterations },
                fraction: (f64::from(iteration) + 1.0 + fraction) / passes,
            },
        }
    }
}

impl TreeStep {
    /// Finding the cells counts as one half, dividing them into words as the other.
    pub(super) fn progress(self, iterations: u32) -> TrainingProgress {
        match self {
            Self::Cells(step) => {
                let TrainingProgress { stage, fraction } = step.progress(iterations);
                TrainingProgress { stage, fraction: fraction / 2.0 }
            }
            Self::Words { trained, cells } => TrainingProgress {
                stage: TrainingStage::Cells { trained, cells },
                fraction: 0.5 + 0.5 * f64::from(trained) / f64::from(cells),
            },
        }
    }
}
