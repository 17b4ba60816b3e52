//! Vocabularies: how long they take to train, how well they fit, and how fast and how exactly they quantize.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use fabmap::codec::Writer;
use fabmap::descriptor::Descriptors;
use fabmap::model::ModelTrainingError;
use fabmap::observation::WordId;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rayon::prelude::*;
use serde::Serialize;
use waypost_vision::features::Feature;

use crate::error::EvalError;
use crate::memory;
use crate::timing::median;
use crate::{files, progress};

/// What to train and to ask.
#[derive(Clone, Debug, PartialEq)]
pub struct VocabularyScaleOptions {
    /// File of descriptors to train on, as [`super::write_descriptors`] makes it.
    pub descriptors: PathBuf,
    /// How many of them, evenly spread.
    pub count: usize,
    /// File of descriptors to quantize: of other images.
    pub queries: PathBuf,
    /// What they are.
    pub feature: Feature,
    /// How to train.
    pub vocabulary: VocabularySettings,
    /// File for the words' centres as rows; `None` writes none.
    pub out: Option<PathBuf>,
}

/// What it cost, and what came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VocabularyScaleReport {
    /// Words.
    pub words: usize,
    /// Descriptors trained on.
    pub descriptors: usize,
    /// Threads.
    pub threads: usize,
    /// Time that training took.
    pub train_seconds: f64,
    /// Most memory held until the end of training, the descriptors included.
    pub train_peak_memory_mib: Option<f64>,
    /// Longest time between two reports of progress, which is how long cancelling takes.
    pub longest_step_ms: f64,
    /// Σ of squared distances of the descriptors trained on from the words that they get.
    pub inertia: f64,
    /// Bytes of the stored vocabulary.
    pub bytes: usize,
    /// Descriptors quantized.
    pub queries: usize,
    /// Time for 1,000 of them on one thread, the median over such blocks.
    pub quantize_1000_ms_p50: Option<f64>,
    /// The 95th percentile.
    pub quantize_1000_ms_p95: Option<f64>,
    /// The same, comparing with every word.
    pub exact_1000_ms_p50: Option<f64>,
    /// Share of queries that get the word that comparing with every word gives.
    pub agreement: f64,
}

/// Descriptors that are timed together.
const TIMED_ROWS: usize = 1000;

/// Trains a vocabulary and quantizes with it.
///
/// # Errors
/// [`EvalError`].
pub fn train_vocabulary(options: &VocabularyScaleOptions) -> Result<VocabularyScaleReport, EvalError> {
    let VocabularyScaleOptions { descriptors, count, queries, feature, vocabulary: settings, out } = options;
    let descriptors = read(descriptors, *feature, *count)?;
    let queries = read(queries, *feature, usize::MAX)?;
    let mut longest_step_ms = 0.0f64;
    let bar = progress::bar("vocabulary", 1000);
    let started = Instant::now();
    let mut last_step = started;
    let vocabulary = Vocabulary::train(&descriptors, settings, &mut |progress| {
        longest_step_ms = longest_step_ms.max(last_step.elapsed().as_secs_f64() * 1e3);
        last_step = Instant::now();
        bar.set_position((progress.fraction * 1000.0) as u64);
        ControlFlow::Continue(())
    })
    .map_err(ModelTrainingError::from)?;
    let train_seconds = started.elapsed().as_secs_f64();
    let train_peak_memory_mib = memory::peak_mib();
    bar.finish_and_clear();

    let exact = vocabulary.with_exact_search();
    let blocks = blocks(&queries);
    let (words, times_ms) = quantize(&vocabulary, &blocks)?;
    let (exact_words, exact_times_ms) = quantize(&exact, &blocks)?;
    let agreeing = words.iter().zip(&exact_words).filter(|(word, exact)| word == exact).count();
    let mut writer = Writer::default();
    vocabulary.encode(&mut writer);
    let centres = vocabulary.centres();
    if let Some(out) = out {
        files::write(out, centres.as_bytes())?;
    }
    let report = VocabularyScaleReport {
        words: vocabulary.len(),
        descriptors: descriptors.len(),
        threads: rayon::current_num_threads(),
        train_seconds,
        train_peak_memory_mib,
        longest_step_ms,
        inertia: inertia(&vocabulary, &centres, &descriptors)?,
        bytes: writer.into_bytes().len(),
        queries: words.len(),
        quantize_1000_ms_p95: percentile(times_ms.clone(), 0.95),
        quantize_1000_ms_p50: median(times_ms),
        exact_1000_ms_p50: median(exact_times_ms),
        agreement: agreeing as f64 / words.len() as f64,
    };
    eprintln!("{report:#?}");
    Ok(report)
}

/// At most `count` rows of the file, evenly spread.
fn read(path: &Path, feature: Feature, count: usize) -> Result<Descriptors, EvalError> {
    let mut bytes = files::read(path)?;
    let width = feature.descriptor_width();
    let rows = bytes.len() / width;
    if count < rows {
        for taken in 0..count {
            let row = (taken as u128 * rows as u128 / count as u128) as usize;
            bytes.copy_within(row * width..(row + 1) * width, taken * width);
        }
        bytes.truncate(count * width);
        bytes.shrink_to_fit();
    }
    Descriptors::new(feature.descriptor_kind(), width, bytes)
        .map_err(|reason| EvalError::Descriptors { path: path.to_owned(), reason })
}

/// The words of all blocks, and how long each block took on one thread. Once over all of them first, so that
/// the vocabulary is in the caches as it is in a server at work.
fn quantize(vocabulary: &Vocabulary, blocks: &[Descriptors]) -> Result<(Vec<WordId>, Vec<f64>), EvalError> {
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (mut words, mut times_ms) = (Vec::new(), Vec::new());
    for timed in [false, true] {
        for block in blocks {
            let started = Instant::now();
            let of_block =
                one_thread.install(|| vocabulary.words(block)).map_err(ModelTrainingError::from)?;
            if timed {
                times_ms.push(started.elapsed().as_secs_f64() * 1e3);
                words.extend(of_block);
            }
        }
    }
    Ok((words, times_ms))
}

/// Whole blocks of [`TIMED_ROWS`]; what is left over is not asked.
fn blocks(queries: &Descriptors) -> Vec<Descriptors> {
    let block = |rows: &[u8]| Descriptors::new(queries.kind(), queries.width(), rows.to_vec());
    queries.as_bytes().chunks_exact(TIMED_ROWS * queries.width()).flat_map(block).collect()
}

fn inertia(vocabulary: &Vocabulary, centres: &Descriptors, rows: &Descriptors) -> Result<f64, EvalError> {
    let words = vocabulary.words(rows).map_err(ModelTrainingError::from)?;
    let distance =
        |(row, word): (&[u8], &WordId)| u64::from(rows.kind().distance(row, centres.row(*word as usize)));
    let rows = rows.as_bytes().par_chunks(rows.width());
    Ok(rows.zip(&words).map(distance).sum::<u64>() as f64)
}

fn percentile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get((values.len() as f64 * share) as usize).copied()
}
