//! 4096 places that follow each other: their postings, and their scores for one query.

use super::directory::Directory;
use super::heavy_words::{FEWEST_PLACES, HeavyWords, set_places};
use super::place_words::PlaceWords;
use super::posting::{BLOCK_PLACES, Posting, RecentByWord};
use super::prefetch::prefetch;
use super::weights::{CLASSES, FixedPoint, LookClass, QueryWeights, class_offset, fixed_point, nats};
use crate::appearance::Appearance;
use crate::likelihood::ObservationModel;
use crate::observation::{Observation, WordId};

/// Postings by word, in three parts. Most are sealed, by word and then by place, and cost two bytes
/// each. Words that an eighth of the places show are bits, for places that were looked at once.
/// What has come since is at hand in no order, and is merged when it has become a thirty-second of
/// the block, or an eighth of one that still grows: so adding is cheap, and so is looking through
/// all that has come.
#[derive(Clone, Debug, Default)]
pub(super) struct Block {
    looks: Vec<u8>,
    /// [`class_offset`] of the looks.
    class_offsets: Vec<LookClass>,
    /// Σ over the place's words: what they say to a query that shows neither word nor parent, in
    /// nats.
    unseen_gains: Vec<FixedPoint>,
    words: Vec<PlaceWords>,
    /// Places with other looks than one.
    otherwise_looked_at: usize,
    /// Where the sealed postings of each word are; empty before the first are sealed.
    directory: Directory,
    sealed: Vec<Posting>,
    heavy: HeavyWords,
    recent_words: Vec<WordId>,
    recent: Vec<Posting>,
}

/// Where a posting is.
#[derive(Clone, Copy, Debug)]
enum Location {
    Sealed(usize),
    Heavy,
    Recent(usize),
}

/// Words whose postings are on their way from memory while those of another are added.
const WORDS_AHEAD: usize = 16;

impl Block {
    /// Number of places.
    pub(super) fn len(&self) -> usize {
        self.looks.len()
    }

    /// n of a place.
    pub(super) fn looks(&self, place: usize) -> u8 {
        self.looks[place]
    }

    pub(super) fn is_full(&self) -> bool {
        self.len() == BLOCK_PLACES
    }

    /// ln p(Z | L) of every place, into as many scores.
    pub(super) fn score(&self, query: &QueryWeights, scores: &mut [f64]) {
        let mut sums = [0; BLOCK_PLACES];
        sums[..self.len()].copy_from_slice(&self.unseen_gains);
        self.heavy.add(query, &mut sums);
        if self.otherwise_looked_at == 0 {
            self.add_sealed(query, |position, postings| {
                let weight = query.words[position].of_one_look;
                postings.iter().for_each(|posting| sums[posting.place()] += weight);
            });
            self.add_recent(query, |position, posting| {
                sums[posting.place()] += query.words[position].of_one_look;
            });
        } else {
            let mut class_offsets = [0; BLOCK_PLACES];
            class_offsets[..self.len()].copy_from_slice(&self.class_offsets);
            self.add_sealed(query, |position, postings| {
                let weights = &query.of_classes[position];
                for posting in postings {
                    let class = class_offsets[posting.place()].wrapping_add(posting.hits());
                    sums[posting.place()] += weights[usize::from(class) % CLASSES];
                }
            });
            self.add_recent(query, |position, posting| {
                let class = class_offsets[posting.place()].wrapping_add(posting.hits());
                sums[posting.place()] += query.of_classes[position][usize::from(class) % CLASSES];
            });
        }
        for ((score, &sum), &looks) in scores.iter_mut().zip(&sums).zip(&self.looks) {
            *score = query.empty_place[usize::from(looks % 16)] + nats(sum);
        }
    }

    /// `add` gets each informative word's position in the query and its sealed postings.
    #[inline(always)]
    fn add_sealed(&self, query: &QueryWeights, mut add: impl FnMut(usize, &[Posting])) {
        if self.directory.is_empty() {
            return;
        }
        // Runs are short and lie far apart: the processor would wait for each. So where a run lies
        // is asked for two steps ahead, and the run itself one step ahead.
        let mut ahead: [&[Posting]; WORDS_AHEAD] = [&[]; WORDS_AHEAD];
        for step in 0..query.words.len() + 2 * WORDS_AHEAD {
            if let Some(weight) = query.words.get(step) {
                self.directory.prefetch(weight.word);
            }
            let slot = step % WORDS_AHEAD;
            if let Some(position) = step.checked_sub(2 * WORDS_AHEAD) {
                add(position, ahead[slot]);
            }
            let fetched = step.checked_sub(WORDS_AHEAD).and_then(|position| query.words.get(position));
            ahead[slot] = fetched.map_or(&[], |weight| self.sealed_of(weight.word));
            prefetch(ahead[slot]);
        }
    }

    /// `add` gets each recent posting of an informative word with that word's position in the
    /// query.
    #[inline(always)]
    fn add_recent(&self, query: &QueryWeights, mut add: impl FnMut(usize, Posting)) {
        for (&word, &posting) in self.recent_words.iter().zip(&self.recent) {
            if let Some(position) = query.position(word) {
                add(position, posting);
            }
        }
    }

    /// Appends a place; there must be room. Call [`Block::settle`] after it, or after several.
    pub(super) fn add(&mut self, model: &ObservationModel, appearance: &Appearance) {
        let place = self.len();
        self.words.push(PlaceWords::new(appearance.word_hits().map(|(word, _)| word)));
        self.looks.push(0);
        self.class_offsets.push(0);
        self.unseen_gains.push(0);
        self.otherwise_looked_at += 1;
        self.set_looks(place, model, appearance);
        for (word, hits) in appearance.word_hits() {
            self.recent_words.push(word);
            self.recent.push(Posting::new(place, hits));
        }
    }

    /// Takes one more look at a place.
    pub(super) fn observe(&mut self, place: usize, model: &ObservationModel, observation: &Observation) {
        let locations = self.locations(place);
        let mut appearance = self.appearance_at(place, &locations);
        appearance.observe(observation);
        let known = self.words[place].iter().zip(locations).collect::<Vec<_>>();
        let mut known = known.into_iter().peekable();
        let words_before = self.words[place].len();
        for (word, hits) in appearance.word_hits() {
            let posting = Posting::new(place, hits);
            match known.next_if(|&(known, _)| known == word) {
                Some((_, Location::Sealed(index))) => self.sealed[index] = posting,
                Some((_, Location::Recent(index))) => self.recent[index] = posting,
                other => {
                    // Bits stand for places looked at once; with a second look it is one no longer.
                    if other.is_some() {
                        self.heavy.remove(word, place);
                    }
                    self.recent_words.push(word);
                    self.recent.push(posting);
                }
            }
        }
        if appearance.word_hits().len() > words_before {
            self.words[place] = PlaceWords::new(appearance.word_hits().map(|(word, _)| word));
        }
        self.set_looks(place, model, &appearance);
        self.settle(model.vocabulary_len());
    }

    fn set_looks(&mut self, place: usize, model: &ObservationModel, appearance: &Appearance) {
        let looks = appearance.looks();
        self.otherwise_looked_at -= usize::from(self.looks[place] != 1);
        self.otherwise_looked_at += usize::from(looks != 1);
        self.looks[place] = looks;
        self.class_offsets[place] = class_offset(looks);
        self.unseen_gains[place] = fixed_point(model.unseen_gain(appearance));
    }

    /// What the place looks like.
    pub(super) fn appearance(&self, place: usize) -> Appearance {
        // A word of a place with one look was seen in it.
        if self.looks[place] <= 1 {
            return Appearance::from_word_hits(
                self.looks[place],
                self.words[place].iter().map(|word| (word, 1)),
            );
        }
        self.appearance_at(place, &self.locations(place))
    }

    fn appearance_at(&self, place: usize, locations: &[Location]) -> Appearance {
        let hits = |location: &Location| match *location {
            Location::Sealed(index) => self.sealed[index].hits(),
            Location::Heavy => 1,
            Location::Recent(index) => self.recent[index].hits(),
        };
        Appearance::from_word_hits(
            self.looks[place],
            self.words[place].iter().zip(locations.iter().map(hits)),
        )
    }

    /// Where the postings of the place's words are.
    fn locations(&self, place: usize) -> Vec<Location> {
        let recent_ones = self.recent.iter().enumerate().filter(|(_, posting)| posting.place() == place);
        let mut recent: Vec<(WordId, usize)> =
            recent_ones.map(|(index, _)| (self.recent_words[index], index)).collect();
        recent.sort_unstable();
        let mut recent = recent.into_iter().peekable();
        let locate = |word: WordId| match recent.next_if(|&(recent, _)| recent == word) {
            Some((_, index)) => Location::Recent(index),
            None => {
                let postings = self.sealed_of(word);
                let index = postings.partition_point(|posting| posting.place() < place);
                match postings.get(index) {
                    Some(posting) if posting.place() == place => {
                        Location::Sealed(self.directory.run(word).start + index)
                    }
                    Some(_) | None => Location::Heavy,
                }
            }
        };
        self.words[place].iter().map(locate).collect()
    }

    /// The places with a word, ascending.
    pub(super) fn places_with(&self, word: WordId) -> Vec<usize> {
        let recent = self.recent_words.iter().zip(&self.recent).filter(|&(&recent, _)| recent == word);
        let recent = recent.map(|(_, posting)| posting.place());
        let sealed = self.sealed_of(word).iter().map(|posting| posting.place());
        let heavy = self.heavy.places_with(word).into_iter().flat_map(set_places);
        let mut places: Vec<usize> = sealed.chain(heavy).chain(recent).collect();
        places.sort_unstable();
        places
    }

    #[inline(always)]
    fn sealed_of(&self, word: WordId) -> &[Posting] {
        &self.sealed[self.directory.run(word)]
    }

    /// Seals what has come since, if it is so much that queries would notice.
    pub(super) fn settle(&mut self, words: usize) {
        let share = if self.is_full() { 32 } else { 8 };
        if self.recent.len() > (words + self.sealed.len()) / share {
            self.merge(words);
        }
    }

    /// Seals the recent postings, and decides again which words are heavy.
    pub(super) fn merge(&mut self, words: usize) {
        let recent = RecentByWord::sorted(&self.recent_words, &self.recent, words);
        let mut sealed: Vec<Posting> = Vec::with_capacity(self.sealed.len() + self.recent.len());
        let mut directory = Directory::with_capacity(words);
        let mut heavy = HeavyWords::default();
        let mut heavy_before = self.heavy.iter().peekable();
        for word in WordId::first(words) {
            let start = sealed.len();
            directory.push(start);
            let known = self.sealed_of(word);
            sealed.extend_from_slice(known);
            if let Some((_, places)) = heavy_before.next_if(|&(heavy, _)| heavy == word) {
                sealed.extend(set_places(places).map(|place| Posting::new(place, 1)));
            }
            sealed.extend_from_slice(recent.of(word));
            if sealed.len() - start > known.len() {
                sealed[start..].sort_unstable_by_key(|posting| posting.place());
            }
            if sealed.len() - start >= FEWEST_PLACES {
                self.make_heavy(word, start, &mut sealed, &mut heavy);
            }
        }
        directory.push(sealed.len());
        drop(heavy_before);
        (self.directory, self.sealed, self.heavy) = (directory, sealed, heavy);
        (self.recent_words, self.recent) = (Vec::new(), Vec::new());
        if self.is_full() {
            self.sealed.shrink_to_fit();
            self.heavy.shrink_to_fit();
            self.looks.shrink_to_fit();
            self.class_offsets.shrink_to_fit();
            self.unseen_gains.shrink_to_fit();
            self.words.shrink_to_fit();
        }
    }

    /// Moves the postings of `word`, those from `start` on, into bits where there are enough for
    /// that.
    fn make_heavy(&self, word: WordId, start: usize, sealed: &mut Vec<Posting>, heavy: &mut HeavyWords) {
        let seen_once = |posting: &Posting| self.looks[posting.place()] == 1;
        if sealed[start..].iter().filter(|posting| seen_once(posting)).count() < FEWEST_PLACES {
            return;
        }
        let mut places = [0; BLOCK_PLACES / 64];
        for posting in sealed[start..].iter().filter(|posting| seen_once(posting)) {
            places[posting.place() / 64] |= 1 << (posting.place() % 64);
        }
        heavy.push(word, places);
        let others: Vec<Posting> = sealed.drain(start..).filter(|posting| !seen_once(posting)).collect();
        sealed.extend(others);
    }

    /// Number of postings.
    pub(super) fn postings(&self) -> usize {
        self.sealed.len() + self.heavy.postings() + self.recent.len()
    }

    /// Memory behind this block, what is reserved included.
    pub(super) fn memory_bytes(&self) -> usize {
        fn of<T>(values: &Vec<T>) -> usize {
            values.capacity() * size_of::<T>()
        }
        of(&self.looks)
            + of(&self.class_offsets)
            + of(&self.unseen_gains)
            + of(&self.words)
            + self.words.iter().map(PlaceWords::memory_bytes).sum::<usize>()
            + self.directory.memory_bytes()
            + of(&self.sealed)
            + of(&self.recent_words)
            + of(&self.recent)
            + self.heavy.memory_bytes()
    }
}
