//! The visual vocabulary: which word a descriptor is.

use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::{DescriptorError, DescriptorKind, Descriptors};
use crate::observation::{Observation, WordId};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::ops::{ControlFlow, RangeInclusive};

pub(crate) use seeding::lower_distances;

mod binary_rows;
mod centres;
mod descent_tree;
mod float_panels;
mod kmeans;
mod orb_text;
mod search_tree;
mod seeding;
mod training_set;
mod x86;

use centres::{BLOCK_ROWS, Centres, Nearest};
use descent_tree::DescentTree;
use kmeans::{Cancelled, Step};
use search_tree::{FIRST_FORM_WORDS_COMPARED, SearchTree, TREE_BLOCK_ROWS, TreeStep};
use training_set::TrainingSet;

pub use descent_tree::TreeError;
pub use orb_text::OrbVocabularyError;

/// A visual vocabulary with its quantizer: each descriptor is the word it is nearest to.
///
/// Distances are integers and equal ones go to the lowest word, so a descriptor has the same word
/// on every machine and on any number of threads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vocabulary {
    kind: DescriptorKind,
    width: usize,
    quantizer: Quantizer,
}

/// How the nearest word is found.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Quantizer {
    /// By comparing with every word.
    Exact(Centres),
    /// By searching the nearest cells of words; nearly exact.
    Tree(SearchTree),
    /// By greedy descent of an imported tree, as whoever made it does.
    Descent(DescentTree),
}

/// What a vocabulary is trained with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VocabularySettings {
    /// Number of words, 2 to 1,000,000. Up to [`Vocabulary::EXACT_WORDS_MAX`] quantization is exact.
    pub words: u32,
    /// Seed of the random choices; the same descriptors and seed give the same vocabulary.
    pub seed: u64,
    /// Iterations of Lloyd's algorithm at most, 1 to 1,000; it stops when nothing improves.
    pub iterations: u32,
}

impl VocabularySettings {
    /// Fewest words of a vocabulary.
    pub const MIN_WORDS: u32 = 2;
    /// Most words of a vocabulary.
    pub const MAX_WORDS: u32 = 1_000_000;
}

impl Default for VocabularySettings {
    fn default() -> Self {
        Self { words: 5_000, seed: 0, iterations: 12 }
    }
}

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

/// Why there is no vocabulary, or no words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VocabularyError {
    /// The number of words is out of range.
    #[error("a vocabulary of {words} words is not supported; ask for {lowest} to {highest}",
        lowest = WORDS.start(), highest = WORDS.end())]
    Words {
        /// Words asked for.
        words: u32,
    },
    /// The number of iterations is out of range.
    #[error("{iterations} iterations are not supported; ask for {lowest} to {highest}",
        lowest = ITERATIONS.start(), highest = ITERATIONS.end())]
    Iterations {
        /// Iterations asked for.
        iterations: u32,
    },
    /// There are fewer different descriptors than words.
    #[error(
        "{words} words cannot be trained from {distinct} different descriptors; \
         give more images or ask for at most {distinct} words"
    )]
    TooFewDescriptors {
        /// Words asked for.
        words: u32,
        /// Different descriptors given.
        distinct: usize,
    },
    /// The observer asked to stop.
    #[error("training was cancelled; nothing was kept, so start it again")]
    Cancelled,
    /// The descriptors are not of this vocabulary's feature.
    #[error(transparent)]
    Descriptors(#[from] DescriptorError),
}

const WORDS: RangeInclusive<u32> = VocabularySettings::MIN_WORDS..=VocabularySettings::MAX_WORDS;
const ITERATIONS: RangeInclusive<u32> = 1..=1_000;

impl Vocabulary {
    /// Up to this many words a trained vocabulary compares a descriptor with every word; above, it
    /// searches a tree. At this size 500 SIFT descriptors take some 6 ms on one core with AVX-512
    /// VNNI, some 30 ms with AVX2.
    pub const EXACT_WORDS_MAX: u32 = 20_000;

    /// Trains k-means (float) or k-majority (binary) words.
    ///
    /// The result depends on the set of descriptors and the settings alone, not on the order of
    /// descriptors or the number of threads. `observer` hears how far it is, every second
    /// or so, and stops it by answering `Break`.
    ///
    /// # Errors
    /// [`VocabularyError`], any but `Descriptors`.
    pub fn train(
        descriptors: &Descriptors,
        settings: &VocabularySettings,
        observer: &mut dyn FnMut(TrainingProgress) -> ControlFlow<()>,
    ) -> Result<Self, VocabularyError> {
        Self::train_with_limit(descriptors, settings, Self::EXACT_WORDS_MAX, observer)
    }

    /// [`Vocabulary::train`] with another limit between exact search and tree.
    fn train_with_limit(
        descriptors: &Descriptors,
        settings: &VocabularySettings,
        exact_words_max: u32,
        observer: &mut dyn FnMut(TrainingProgress) -> ControlFlow<()>,
    ) -> Result<Self, VocabularyError> {
        let &VocabularySettings { words, seed, iterations } = settings;
        if !WORDS.contains(&words) {
            return Err(VocabularyError::Words { words });
        }
        if !ITERATIONS.contains(&iterations) {
            return Err(VocabularyError::Iterations { iterations });
        }
        let set = TrainingSet::new(descriptors);
        if set.len() < words as usize {
            return Err(VocabularyError::TooFewDescriptors { words, distinct: set.len() });
        }
        let quantizer = if words <= exact_words_max {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let clusters = kmeans::cluster(&set, words as usize, iterations, &mut random, &mut |step| {
                observer(exact_progress(step, iterations))
            });
            clusters.map(|found| Quantizer::Exact(Centres::pack(set.kind, set.width, &found.centres)))
        } else {
            SearchTree::train(&set, words as usize, iterations, seed, &mut |step| {
                observer(tree_progress(step, iterations))
            })
            .map(Quantizer::Tree)
        };
        match quantizer {
            Ok(quantizer) => Ok(Self { kind: set.kind, width: set.width, quantizer }),
            Err(Cancelled) => Err(VocabularyError::Cancelled),
        }
    }

    /// Reads the text format of ORB vocabularies (`ORBvoc.txt`), as DBoW2 writes it. Words are the
    /// leaves in file order and the tree is kept: descriptors get the words that DBoW2 gives them.
    ///
    /// # Errors
    /// [`OrbVocabularyError`] with the line that is wrong.
    pub fn from_orb_text(text: &str) -> Result<Self, OrbVocabularyError> {
        let tree = orb_text::parse(text)?;
        let quantizer = Quantizer::Descent(tree);
        Ok(Self { kind: DescriptorKind::Binary, width: orb_text::ORB_BYTES, quantizer })
    }

    /// Number of words.
    #[must_use]
    pub fn len(&self) -> usize {
        match &self.quantizer {
            Quantizer::Exact(centres) => centres.len(),
            Quantizer::Tree(tree) => tree.len(),
            Quantizer::Descent(tree) => tree.len(),
        }
    }

    /// False: a vocabulary has a word at least.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Kind of the descriptors it quantizes.
    #[must_use]
    pub fn kind(&self) -> DescriptorKind {
        self.kind
    }

    /// Bytes of a descriptor.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// The descriptor that each word stands for, in order of word.
    #[must_use]
    pub fn centres(&self) -> Descriptors {
        let rows = match &self.quantizer {
            Quantizer::Exact(centres) => centres.rows(),
            Quantizer::Tree(tree) => tree.word_rows(),
            Quantizer::Descent(tree) => tree.word_rows(),
        };
        Descriptors::new(self.kind, self.width, rows)
            .unwrap_or_else(|_| unreachable!("every quantizer has whole rows of width()"))
    }

    /// The same words, but each descriptor is compared with every one of them: what the searches of
    /// large vocabularies are measured against.
    #[must_use]
    pub fn with_exact_search(&self) -> Self {
        let centres = Centres::pack(self.kind, self.width, self.centres().as_bytes());
        Self { kind: self.kind, width: self.width, quantizer: Quantizer::Exact(centres) }
    }

    /// Word of one descriptor.
    ///
    /// # Panics
    /// If the descriptor has not [`Vocabulary::width`] bytes.
    #[must_use]
    pub fn word(&self, descriptor: &[u8]) -> WordId {
        assert_eq!(descriptor.len(), self.width, "bytes of the descriptor");
        match &self.quantizer {
            Quantizer::Exact(centres) => centres.nearest_one(descriptor).id,
            Quantizer::Tree(tree) => {
                let mut word = [0];
                tree.words(self.width, descriptor, &mut word);
                word[0]
            }
            Quantizer::Descent(tree) => tree.word(descriptor),
        }
    }

    /// Word of each descriptor, in order; on all threads.
    ///
    /// # Errors
    /// [`VocabularyError::Descriptors`] if kind or width are not the vocabulary's.
    pub fn words(&self, descriptors: &Descriptors) -> Result<Vec<WordId>, VocabularyError> {
        if (descriptors.kind(), descriptors.width()) != (self.kind, self.width) {
            return Err(VocabularyError::Descriptors(DescriptorError::Mismatch {
                expected: self.kind,
                expected_width: self.width,
                found: descriptors.kind(),
                found_width: descriptors.width(),
            }));
        }
        let mut words = vec![0; descriptors.len()];
        let block_rows = self.block_rows(words.len());
        words
            .par_chunks_mut(block_rows)
            .zip(descriptors.as_bytes().par_chunks(block_rows * self.width))
            .for_each(|(words, rows)| self.quantize_block(rows, words));
        Ok(words)
    }

    /// What an image with these descriptors shows.
    ///
    /// # Errors
    /// See [`Vocabulary::words`].
    pub fn observe(&self, descriptors: &Descriptors) -> Result<Observation, VocabularyError> {
        let observation = Observation::from_words(self.words(descriptors)?, self.len());
        Ok(observation.unwrap_or_else(|_| unreachable!("every quantizer's words are below len()")))
    }

    /// Rows that one thread looks up together. The more meet in a cell of a tree the better, but every
    /// thread is to have its part of an image.
    fn block_rows(&self, rows: usize) -> usize {
        match &self.quantizer {
            Quantizer::Exact(_) | Quantizer::Descent(_) => BLOCK_ROWS,
            Quantizer::Tree(_) => {
                rows.div_ceil(rayon::current_num_threads()).clamp(BLOCK_ROWS, TREE_BLOCK_ROWS)
            }
        }
    }

    fn quantize_block(&self, rows: &[u8], words: &mut [WordId]) {
        match &self.quantizer {
            Quantizer::Exact(centres) => {
                let mut nearest = [Nearest::default(); BLOCK_ROWS];
                let nearest = &mut nearest[..words.len()];
                centres.nearest(rows, nearest);
                for (word, nearest) in words.iter_mut().zip(nearest) {
                    *word = nearest.id;
                }
            }
            Quantizer::Tree(tree) => tree.words(self.width, rows, words),
            Quantizer::Descent(tree) => {
                for (word, row) in words.iter_mut().zip(rows.chunks_exact(self.width)) {
                    *word = tree.word(row);
                }
            }
        }
    }

    /// Appends the byte form: kind, width, quantizer, then the centres as bytes.
    pub fn encode(&self, writer: &mut Writer) {
        writer.u8(match self.kind {
            DescriptorKind::Float => 0,
            DescriptorKind::Binary => 1,
        });
        writer.varint(self.width as u64);
        match &self.quantizer {
            Quantizer::Exact(centres) => {
                writer.u8(0);
                centres.encode(writer);
            }
            Quantizer::Tree(tree) => {
                match tree.words_compared() {
                    FIRST_FORM_WORDS_COMPARED => writer.u8(1),
                    words_compared => {
                        writer.u8(3);
                        writer.varint(u64::from(words_compared));
                    }
                }
                tree.encode(writer);
            }
            Quantizer::Descent(tree) => {
                writer.u8(2);
                tree.encode(writer);
            }
        }
    }

    /// Reads what [`Vocabulary::encode`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut or not a vocabulary.
    pub fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let kind = match reader.u8()? {
            0 => DescriptorKind::Float,
            1 => DescriptorKind::Binary,
            other => return Err(DecodeError::invalid(format_args!("descriptor kind {other}"))),
        };
        let width = reader.varint_u32()? as usize;
        if width == 0 || width > Descriptors::MAX_WIDTH {
            return Err(DecodeError::invalid(format_args!("descriptors of {width} bytes")));
        }
        let quantizer = match reader.u8()? {
            0 => Quantizer::Exact(Centres::decode(kind, width, reader)?),
            1 => Quantizer::Tree(SearchTree::decode(kind, width, FIRST_FORM_WORDS_COMPARED, reader)?),
            2 => Quantizer::Descent(DescentTree::decode(kind, width, reader)?),
            3 => {
                let words_compared = reader.varint_u32()?;
                // That many has a form of its own: what is the same has the same bytes, and so the same name.
                if words_compared == 0 || words_compared == FIRST_FORM_WORDS_COMPARED {
                    let compared = format_args!("a tree that compares {words_compared} words");
                    return Err(DecodeError::invalid(compared));
                }
                Quantizer::Tree(SearchTree::decode(kind, width, words_compared, reader)?)
            }
            other => return Err(DecodeError::invalid(format_args!("quantizer {other}"))),
        };
        Ok(Self { kind, width, quantizer })
    }
}

/// Seeding counts as one iteration of those at most, assigning to the first centres as another.
fn exact_progress(step: Step, iterations: u32) -> TrainingProgress {
    let passes = f64::from(iterations) + 2.0;
    match step {
        Step::Seeding { fraction } => {
            TrainingProgress { stage: TrainingStage::Seeding, fraction: fraction / passes }
        }
        Step::Iteration { iteration, fraction } => TrainingProgress {
            stage: TrainingStage::Iteration { iteration, iterations },
            fraction: (f64::from(iteration) + 1.0 + fraction) / passes,
        },
    }
}

/// Finding the cells counts as one half, dividing them into words as the other.
fn tree_progress(step: TreeStep, iterations: u32) -> TrainingProgress {
    match step {
        TreeStep::Cells(step) => {
            let TrainingProgress { stage, fraction } = exact_progress(step, iterations);
            TrainingProgress { stage, fraction: fraction / 2.0 }
        }
        TreeStep::Words { trained, cells } => TrainingProgress {
            stage: TrainingStage::Cells { trained, cells },
            fraction: 0.5 + 0.5 * f64::from(trained) / f64::from(cells),
        },
    }
}

#[cfg(test)]
mod tests;
