//! Chow-Liu training on the synthetic workload.

use std::ops::ControlFlow;
use std::time::Instant;

use fabmap::chow_liu::{ChowLiuTree, TreeTrainingSettings};
use fabmap::model::ModelTrainingError;
use fabmap::observation::Observation;
use serde::Serialize;

use crate::error::EvalError;
use crate::memory;
use crate::progress;
use crate::workload::{Use, Workload, WorkloadSettings};

/// What to learn a tree from.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeScaleOptions {
    /// The distribution of images.
    pub workload: WorkloadSettings,
    /// Images to draw from it.
    pub images: u32,
}

/// What it cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TreeScaleReport {
    /// V.
    pub words: u32,
    /// Images learnt from.
    pub images: u32,
    /// Words in all images together.
    pub sightings: usize,
    /// Threads.
    pub threads: usize,
    /// Time that learning took.
    pub seconds: f64,
    /// Most memory that drawing the images and learning held.
    pub peak_memory_mib: Option<f64>,
    /// Longest time between two reports of progress, which is how long cancelling takes.
    pub longest_step_ms: f64,
    /// Words that have a parent.
    pub edges: usize,
    /// Of these, the words whose parent in the workload's own tree is joined to them here too.
    pub true_edges: usize,
}

/// Draws images and learns a tree from them.
///
/// # Errors
/// [`EvalError`] if the settings make no images.
pub fn train_tree(options: &TreeScaleOptions) -> Result<TreeScaleReport, EvalError> {
    let &TreeScaleOptions { workload: settings, images } = options;
    let workload = Workload::new(settings)?;
    let observations = workload.images(Use::Training, images);
    let bar = progress::bar("Chow-Liu tree", 1000);
    let mut longest_step_ms = 0.0f64;
    let started = Instant::now();
    let mut last_step = started;
    let tree = ChowLiuTree::train(
        &observations,
        settings.words as usize,
        TreeTrainingSettings::default(),
        &mut |fraction| {
            longest_step_ms = longest_step_ms.max(last_step.elapsed().as_secs_f64() * 1e3);
            last_step = Instant::now();
            bar.set_position((fraction * 1000.0) as u64);
            ControlFlow::Continue(())
        },
    );
    let tree = tree.map_err(ModelTrainingError::from)?;
    let seconds = started.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let parents = |tree: &ChowLiuTree| -> Vec<Option<u32>> {
        (0..settings.words).map(|word| tree.parent(word)).collect()
    };
    let (learnt, own) = (parents(&tree), parents(workload.tree()));
    let joined = |word: u32, parent: u32| {
        learnt[word as usize] == Some(parent) || learnt[parent as usize] == Some(word)
    };
    let report = TreeScaleReport {
        words: settings.words,
        images,
        sightings: observations.iter().map(Observation::len).sum(),
        threads: rayon::current_num_threads(),
        seconds,
        peak_memory_mib: memory::peak_mib(),
        longest_step_ms,
        edges: learnt.iter().flatten().count(),
        true_edges: (0..).zip(&own).filter(|&(word, parent)| parent.is_some_and(|p| joined(word, p))).count(),
    };
    eprintln!(
        "{} words, {images} images, {} threads: {seconds:.1} s, {:.0} MiB",
        settings.words,
        report.threads,
        report.peak_memory_mib.unwrap_or(f64::NAN),
    );
    Ok(report)
}
