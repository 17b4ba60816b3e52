//! A place that has a word, in two bytes.

use crate::observation::WordId;

/// Places whose scores stay in the first-level cache while all words of a query are added; so many
/// that a place's number within the block leaves the four bits that its k needs in a posting of 16.
pub(super) const BLOCK_PLACES: usize = 4096;

/// A place within its block (the lower 12 bits) with the k of one word there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Posting(u16);

impl Posting {
    pub(super) fn new(place: usize, hits: u8) -> Self {
        Self((usize::from(hits) << 12 | place) as u16)
    }

    #[inline(always)]
    pub(super) fn place(self) -> usize {
        usize::from(self.0) % BLOCK_PLACES
    }

    #[inline(always)]
    pub(super) fn hits(self) -> u8 {
        (self.0 >> 12) as u8
    }
}

/// Recent postings by word; of each in the order they came in.
pub(super) struct RecentByWord {
    first: Vec<u32>,
    postings: Vec<Posting>,
}

impl RecentByWord {
    /// By counting, in time proportional to postings and words.
    pub(super) fn sorted(words_of: &[WordId], postings: &[Posting], words: usize) -> Self {
        let mut first = vec![0; words + 1];
        words_of.iter().for_each(|&word| first[word.index() + 1] += 1);
        for word in 0..words {
            first[word + 1] += first[word];
        }
        let mut next = first.clone();
        let mut sorted = vec![Posting(0); postings.len()];
        for (&word, &posting) in words_of.iter().zip(postings) {
            sorted[next[word.index()] as usize] = posting;
            next[word.index()] += 1;
        }
        Self { first, postings: sorted }
    }

    pub(super) fn of(&self, word: WordId) -> &[Posting] {
        let first = self.first[word.index()];
        let end = self.first[word.index() + 1];
        &self.postings[first as usize..end as usize]
    }
}
