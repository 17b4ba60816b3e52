//! Where each word's postings begin.

use std::ops::Range;

use super::posting::BLOCK_PLACES;
use super::prefetch::prefetch;
use crate::observation::WordId;

/// Starts of runs that follow each other, one per word. The 14 words of a group share 32 bytes, so
/// that a run is found with one line of memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Directory {
    groups: Vec<Group>,
    /// Starts that were pushed: one more than there are words.
    len: usize,
}

#[derive(Clone, Copy, Debug, Default)]
#[repr(align(32))]
struct Group {
    /// Where the run of the first word starts.
    start: u32,
    /// What the other starts are beyond that.
    beyond: [u16; GROUP_WORDS],
}

const GROUP_WORDS: usize = 14;
const _: () = assert!(size_of::<Group>() == 32);
const _: () = assert!((GROUP_WORDS - 1) * BLOCK_PLACES <= u16::MAX as usize);

impl Directory {
    /// Room for the runs of `words` words.
    pub(super) fn with_capacity(words: usize) -> Self {
        Self { groups: Vec::with_capacity((words + 1).div_ceil(GROUP_WORDS)), len: 0 }
    }

    /// Where the run of the next word starts; after the last word's, where it ends.
    pub(super) fn push(&mut self, start: usize) {
        if self.len.is_multiple_of(GROUP_WORDS) {
            self.groups.push(Group { start: start as u32, ..Group::default() });
        }
        if let Some(group) = self.groups.last_mut() {
            group.beyond[self.len % GROUP_WORDS] = (start - group.start as usize) as u16;
        }
        self.len += 1;
    }

    /// True if nothing has been pushed.
    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The run of a word; empty where there is nothing yet.
    #[inline(always)]
    pub(super) fn run(&self, word: WordId) -> Range<usize> {
        let word = word.index();
        let start = |word: usize| {
            let group = &self.groups[word / GROUP_WORDS];
            group.start as usize + usize::from(group.beyond[word % GROUP_WORDS])
        };
        if word + 1 < self.len { start(word)..start(word + 1) } else { 0..0 }
    }

    /// Has the processor fetch what [`Directory::run`] reads; all but the next group, which is
    /// mostly not needed.
    #[inline(always)]
    pub(super) fn prefetch(&self, word: WordId) {
        let group = word.index() / GROUP_WORDS;
        prefetch(&self.groups[group..=group]);
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.groups.capacity() * size_of::<Group>()
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
            prop_assert_eq!(directory.run(WordId::new(0)), 0..0);
            let mut start = 0;
            for length in &lengths {
                directory.push(start);
                start += length;
            }
            directory.push(start);
            let mut start = 0;
            for (word, length) in WordId::all().zip(&lengths) {
                directory.prefetch(word);
                prop_assert_eq!(directory.run(word), start..start + length);
                start += length;
            }
        }
    }
}
