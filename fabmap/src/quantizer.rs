//! Which word a descriptor is: the word whose centre is nearest to it.

mod binary_rows;
mod centres;
mod descent_tree;
mod float_panels;
mod float_search;
mod kernels;
mod lane_best;
mod nearest;
mod search_tree;

use rayon::prelude::*;

use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::DescriptorKind;
use crate::observation::WordId;

use search_tree::TREE_BLOCK_ROWS;

pub(crate) use centres::{BLOCK_ROWS, Centres};
pub use descent_tree::TreeError;
pub(crate) use descent_tree::{DescentTree, DescentTreeBuilder, MAX_BRANCHING, MAX_DEPTH};
pub(crate) use nearest::Nearest;
pub(crate) use search_tree::{FIRST_FORM_WORDS_COMPARED, SearchTree};

/// How the nearest word is found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Quantizer {
    /// By comparing with every word.
    Exact(Centres),
    /// By searching the nearest cells of words; nearly exact.
    Tree(SearchTree),
    /// By greedy descent of an imported tree, as the software that it was made for does.
    Descent(DescentTree),
}

impl Quantizer {
    /// Number of words.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Exact(centres) => centres.len(),
            Self::Tree(tree) => tree.len(),
            Self::Descent(tree) => tree.len(),
        }
    }

    /// The descriptor of each word as consecutive rows, in the order of the words' numbers.
    pub(crate) fn word_rows(&self) -> Vec<u8> {
        match self {
            Self::Exact(centres) => centres.rows(),
            Self::Tree(tree) => tree.word_rows(),
            Self::Descent(tree) => tree.word_rows(),
        }
    }

    /// Word of one descriptor.
    pub(crate) fn word(&self, descriptor: &[u8]) -> WordId {
        match self {
            Self::Exact(centres) => WordId::new(centres.nearest_one(descriptor).id),
            Self::Tree(tree) => {
                let mut word = [WordId::default()];
                tree.words(descriptor.len(), descriptor, &mut word);
                word[0]
            }
            Self::Descent(tree) => tree.word(descriptor),
        }
    }

    /// Word of each of consecutive rows of `width` bytes; on all threads.
    pub(crate) fn words(&self, width: usize, rows: &[u8]) -> Vec<WordId> {
        let mut words = vec![WordId::default(); rows.len() / width];
        let block_rows = self.block_rows(words.len());
        words
            .par_chunks_mut(block_rows)
            .zip(rows.par_chunks(block_rows * width))
            .for_each(|(words, rows)| self.quantize_block(width, rows, words));
        words
    }

    /// Rows that one thread looks up together. The more meet in a cell of a tree the better, but
    /// every thread is to have its part of an image.
    fn block_rows(&self, rows: usize) -> usize {
        match self {
            Self::Exact(_) | Self::Descent(_) => BLOCK_ROWS,
            Self::Tree(_) => rows.div_ceil(rayon::current_num_threads()).clamp(BLOCK_ROWS, TREE_BLOCK_ROWS),
        }
    }

    fn quantize_block(&self, width: usize, rows: &[u8], words: &mut [WordId]) {
        match self {
            Self::Exact(centres) => {
                let mut nearest = [Nearest::default(); BLOCK_ROWS];
                let nearest = &mut nearest[..words.len()];
                centres.nearest(rows, nearest);
                for (word, nearest) in words.iter_mut().zip(nearest) {
                    *word = WordId::new(nearest.id);
                }
            }
            Self::Tree(tree) => tree.words(width, rows, words),
            Self::Descent(tree) => {
                for (word, row) in words.iter_mut().zip(rows.chunks_exact(width)) {
                    *word = tree.word(row);
                }
            }
        }
    }

    /// Appends the byte form: which quantizer, then its words.
    pub(crate) fn encode(&self, writer: &mut Writer) {
        match self {
            Self::Exact(centres) => {
                writer.u8(0);
                centres.encode(writer);
            }
            Self::Tree(tree) => {
                match tree.words_compared() {
                    FIRST_FORM_WORDS_COMPARED => writer.u8(1),
                    words_compared => {
                        writer.u8(3);
                        writer.varint(u64::from(words_compared));
                    }
                }
                tree.encode(writer);
            }
            Self::Descent(tree) => {
                writer.u8(2);
                tree.encode(writer);
            }
        }
    }

    /// Reads what [`Quantizer::encode`] wrote, for descriptors of `kind` and `width` bytes.
    pub(crate) fn decode(
        kind: DescriptorKind,
        width: usize,
        reader: &mut Reader<'_>,
    ) -> Result<Self, DecodeError> {
        match reader.u8()? {
            0 => Centres::decode(kind, width, reader).map(Self::Exact),
            1 => SearchTree::decode(kind, width, FIRST_FORM_WORDS_COMPARED, reader).map(Self::Tree),
            2 => DescentTree::decode(kind, width, reader).map(Self::Descent),
            3 => {
                let words_compared = reader.varint_u32()?;
                // That many has a form of its own: equal vocabularies have equal bytes, and so one
                // name.
                if words_compared == 0 || words_compared == FIRST_FORM_WORDS_COMPARED {
                    let compared = format_args!("a tree that compares {words_compared} words");
                    return Err(DecodeError::invalid(compared));
                }
                SearchTree::decode(kind, width, words_compared, reader).map(Self::Tree)
            }
            other => Err(DecodeError::invalid(format_args!("quantizer {other}"))),
        }
    }
}
