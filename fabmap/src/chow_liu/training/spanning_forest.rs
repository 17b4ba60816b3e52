//! The forest with the greatest sum of mutual information over its edges.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::ops::ControlFlow;

use super::TreeTrainingError;
use super::word_statistics::{Edge, WordStatistics};
use crate::observation::{Observation, WordId};

/// A word that may join the forest next: the most informative edge first, then the lower word.
#[derive(PartialEq)]
struct Candidate {
    mutual_information_nats: f64,
    word: WordId,
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.mutual_information_nats
            .total_cmp(&other.mutual_information_nats)
            .then_with(|| other.word.cmp(&self.word))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Images counted between two looks at whether progress is to be reported.
const IMAGES_PER_STEP: usize = 4096;

/// Words looked at between two calls of the observer: a tenth of a second or so.
const WORDS_PER_REPORT: u64 = 1 << 24;

/// Prim's algorithm from the most frequent word of each component; `None` for roots.
pub(super) fn maximum_spanning_forest(
    observations: &[Observation],
    statistics: &WordStatistics,
    observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Vec<Option<Edge>>, TreeTrainingError> {
    let words = statistics.seen.len();
    let mut best: Vec<Option<Edge>> = vec![None; words];
    let mut joined = vec![false; words];
    let mut candidates = BinaryHeap::new();
    let mut co_occurrences = CoOccurrences::new(words);
    let mut progress = Progress::of(observations);
    let mut roots: Vec<WordId> = WordId::first(words).collect();
    roots.sort_by_key(|&word| (std::cmp::Reverse(statistics.seen[word.index()]), word));
    for root in roots {
        if joined[root.index()] {
            continue;
        }
        candidates.push(Candidate { mutual_information_nats: 0.0, word: root });
        while let Some(Candidate { word, .. }) = candidates.pop() {
            if std::mem::replace(&mut joined[word.index()], true) {
                continue;
            }
            for images in statistics.images_of(word).chunks(IMAGES_PER_STEP) {
                progress.report(observer)?;
                progress.done += co_occurrences.count(images, observations, &joined);
            }
            for (other, both) in co_occurrences.drain() {
                let seen = statistics.seen[word.index()];
                let other_seen = statistics.seen[other.index()];
                let mutual_information_nats = statistics.mutual_information_nats(seen, other_seen, both);
                let edge = Edge { parent: word, both, mutual_information_nats };
                if mutual_information_nats > 0.0 && improves(&edge, best[other.index()].as_ref()) {
                    best[other.index()] = Some(edge);
                    candidates.push(Candidate { mutual_information_nats, word: other });
                }
            }
        }
    }
    Ok(best)
}

fn improves(edge: &Edge, best: Option<&Edge>) -> bool {
    best.is_none_or(|best| {
        let order = edge.mutual_information_nats.total_cmp(&best.mutual_information_nats);
        order.then_with(|| best.parent.cmp(&edge.parent)).is_gt()
    })
}

/// How far training is, in what takes the time: words looked at, Σ|Z|² in all.
struct Progress {
    all: u64,
    done: u64,
    /// `done` when the observer was called last; `None` before the first call.
    reported: Option<u64>,
}

impl Progress {
    fn of(observations: &[Observation]) -> Self {
        let all = observations.iter().map(|z| (z.len() as u64).pow(2)).sum();
        Self { all, done: 0, reported: None }
    }

    fn report(&mut self, observer: &mut dyn FnMut(f64) -> ControlFlow<()>) -> Result<(), TreeTrainingError> {
        if self.reported.is_some_and(|reported| self.done - reported < WORDS_PER_REPORT) {
            return Ok(());
        }
        self.reported = Some(self.done);
        match observer(self.done as f64 / self.all as f64) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(TreeTrainingError::Cancelled),
        }
    }
}

/// In how many images one word meets each other word.
struct CoOccurrences {
    counts: Vec<u32>,
    met: Vec<WordId>,
}

impl CoOccurrences {
    fn new(words: usize) -> Self {
        Self { counts: vec![0; words], met: Vec::new() }
    }

    /// Counts the words of these images that have not joined yet; returns how many words it looked
    /// at.
    fn count(&mut self, images: &[u32], observations: &[Observation], joined: &[bool]) -> u64 {
        let mut looked_at = 0;
        for &image in images {
            let words = observations[image as usize].words();
            looked_at += words.len() as u64;
            for &other in words {
                if joined[other.index()] {
                    continue;
                }
                let count = &mut self.counts[other.index()];
                if *count == 0 {
                    self.met.push(other);
                }
                *count += 1;
            }
        }
        looked_at
    }

    fn drain(&mut self) -> impl Iterator<Item = (WordId, u32)> + '_ {
        let counts = &mut self.counts;
        self.met.drain(..).map(|other| (other, std::mem::take(&mut counts[other.index()])))
    }
}
