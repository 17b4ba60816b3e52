//! Where each word's postings begin.

use std::ops::Range;

use super::block::BLOCK_PLACES;
use super::prefetch::prefetch;
use crate::observation::WordId;

/// Starts of runs that follow each other, one per word: an offset for every 16 words, and what is beyond it for each.
#[derive(Clone, Debug, Default)]
pub(super) struct Directory {
    groups: Vec<u32>,
    /// At most 15 runs of a block's places: 16 bits hold it.
    beyond: Vec<u16>,
}

const GROUP_WORDS: usize = 16;
const _: () = assert!((GROUP_WORDS - 1) * BLOCK_PLACES <= u16::MAX as usize);

impl Directory {
    /// Room for the runs of `words` words.
    pub(super) fn with_capacity(words: usize) -> Self {
        let entries = words + 1;
        Self {
            groups: Vec::with_capacity(entries.div_ceil(GROUP_WORDS)),
            beyond: Vec::with_capacity(entries),
        }
    }

    /// Where the run of the next word starts; after the last word's, where it ends.
    pub(super) fn push(&mut self, start: usize) {
        if self.beyond.len().is_multiple_of(GROUP_WORDS) {
            self.groups.push(start as u32);
        }
        let group = self.groups.last().map_or(0, |&group| group as usize);
        self.beyond.push((start - group) as u16);
    }

    /// True if nothing has been pushed.
    pub(super) fn is_empty(&self) -> bool {
        self.beyond.is_empty()
    }

    /// The run of a word; empty where there is nothing yet.
    #[inline(always)]
    pub(super) fn run(&self, word: WordId) -> Range<usize> {
        let word = word as usize;
        match (self.beyond.get(word), self.beyond.get(word + 1)) {
            (Some(&start), Some(&end)) => {
                let group = |word: usize| self.groups[word / GROUP_WORDS] as usize;
                group(word) + usize::from(start)..group(word + 1) + usize::from(end)
            }
            _ => 0..0,
        }
    }

    /// Has the processor fetch what [`Directory::run`] reads.
    #[inline(always)]
    pub(super) fn prefetch(&self, word: WordId) {
        let word = word as usize;
        prefetch(&self.beyond[word..=word]);
        prefetch(&self.groups[word / GROUP_WORDS..=word / GROUP_WORDS]);
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.groups.capacity() * size_of::<u32>() + self.beyond.capacity() * size_of::<u16>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_follow_each_other(lengths in proptest::collection::vec(prop_oneof![0..5usize, Just(BLOCK_PLACES)], 0..100)) {
            let mut directory = Directory::with_capacity(lengths.len());
            prop_assert_eq!(directory.run(0), 0..0);
            let mut start = 0;
            for length in &lengths {
                directory.push(start);
                start += length;
            }
            directory.push(start);
            let mut start = 0;
            for (word, length) in (0..).zip(&lengths) {
                directory.prefetch(word);
                prop_assert_eq!(directory.run(word), start..start + length);
                start += length;
            }
        }
    }
}
