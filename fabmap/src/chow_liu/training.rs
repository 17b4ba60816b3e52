//! Learning the tree from training observations.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::ops::ControlFlow;

use super::{ChowLiuError, ChowLiuTree, WordDependence};
use crate::observation::{Observation, WordId};

/// Settings of [`ChowLiuTree::train`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeTrainingSettings {
    /// Strength of the prior on every probability, in images: a marginal is drawn to the mean rate
    /// of all words, a conditional to its word's marginal, as if so many images had shown it.
    /// Above 0.
    pub prior_images: f64,
}

impl Default for TreeTrainingSettings {
    fn default() -> Self {
        Self { prior_images: 1.0 }
    }
}

/// Why no tree could be learnt.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TreeTrainingError {
    /// No observation to learn from.
    #[error("a Chow-Liu tree is learnt from observations, and there are none; give at least one image")]
    NoObservations,
    /// An observation has a word that the vocabulary does not.
    #[error("observation {observation} has word {word}, the vocabulary ends at {words} words; quantize anew")]
    UnknownWord {
        /// Number of the observation, from 0.
        observation: usize,
        /// The word.
        word: WordId,
        /// Words in the vocabulary.
        words: usize,
    },
    /// The prior is not a positive number.
    #[error("the prior must be a positive number of images, not {prior_images}; 1 is a good start")]
    Prior {
        /// The prior given.
        prior_images: f64,
    },
    /// The observer asked to stop.
    #[error("training was cancelled")]
    Cancelled,
    /// The vocabulary cannot carry a tree.
    #[error(transparent)]
    Tree(#[from] ChowLiuError),
}

impl ChowLiuTree {
    /// Learns the maximum spanning forest over the mutual information of `words` words.
    ///
    /// An edge joins two words only if some image shows both: a pair that never met has nothing to
    /// say about p(z_q = 1 | z_pq = 1), so words that meet no other stay roots. Mutual information is
    /// that of the plain counts; probabilities are then smoothed by `settings.prior_images`.
    ///
    /// Prim's algorithm: when a word joins the forest its co-occurrences are counted from the images
    /// that show it, so memory is linear in words and observations and time is Σ|Z|² (words are
    /// sparse; compare Meilă's accelerated Chow-Liu, 1999). `observer` hears the fraction done, in
    /// [0, 1], and may cancel. Ties go to the lower word id.
    ///
    /// # Errors
    /// [`TreeTrainingError`].
    pub fn train(
        observations: &[Observation],
        words: usize,
        settings: TreeTrainingSettings,
        observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Self, TreeTrainingError> {
        let statistics = WordStatistics::count(observations, words, settings.prior_images)?;
        let edges = maximum_spanning_forest(observations, &statistics, observer)?;
        Ok(Self::from_rows((0..).zip(edges).map(|(word, edge)| statistics.dependence(word, edge)))?)
    }
}

/// The edge from a word to its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Edge {
    parent: WordId,
    /// Images that show both.
    both: u32,
    mutual_information_nats: f64,
}

struct WordStatistics {
    images: u32,
    /// Images that show each word.
    seen: Vec<u32>,
    /// Images of word q: `images_of[first_image[q]..first_image[q + 1]]`.
    first_image: Vec<usize>,
    images_of: Vec<u32>,
    /// x ln x for x = 0..=images.
    x_ln_x: Vec<f64>,
    prior_images: f64,
    /// How often a word is seen on average, in (0, 1).
    mean_rate: f64,
}

impl WordStatistics {
    fn count(
        observations: &[Observation],
        words: usize,
        prior_images: f64,
    ) -> Result<Self, TreeTrainingError> {
        if !(prior_images > 0.0 && prior_images.is_finite()) {
            return Err(TreeTrainingError::Prior { prior_images });
        }
        let images = u32::try_from(observations.len()).unwrap_or(u32::MAX);
        if images == 0 {
            return Err(TreeTrainingError::NoObservations);
        }
        let mut first_image = vec![0usize; words + 1];
        for (observation, z) in observations.iter().enumerate() {
            for &word in z.words() {
                let count = first_image.get_mut(word as usize + 1);
                *count.ok_or(TreeTrainingError::UnknownWord { observation, word, words })? += 1;
            }
        }
        let seen: Vec<u32> = first_image[1..].iter().map(|&count| count as u32).collect();
        for word in 0..words {
            first_image[word + 1] += first_image[word];
        }
        let mut next = first_image.clone();
        let mut images_of = vec![0u32; first_image[words]];
        for (image, z) in (0u32..).zip(observations) {
            for &word in z.words() {
                images_of[next[word as usize]] = image;
                next[word as usize] += 1;
            }
        }
        let x_ln_x =
            (0..=images).map(|x| if x == 0 { 0.0 } else { f64::from(x) * f64::from(x).ln() }).collect();
        // One imagined sighting and one imagined miss keep the rate off 0 and 1.
        let mean_rate = (images_of.len() as f64 + 1.0) / (f64::from(images) * words as f64 + 2.0);
        Ok(Self { images, seen, first_image, images_of, x_ln_x, prior_images, mean_rate })
    }

    fn images_of(&self, word: WordId) -> &[u32] {
        &self.images_of[self.first_image[word as usize]..self.first_image[word as usize + 1]]
    }

    /// Mutual information of two words seen in `a` and `b` images, `both` of them in common:
    /// Σ p(x, y) ln [p(x, y) / (p(x) p(y))] over the four states, in nats. Symmetric to the bit.
    fn mutual_information_nats(&self, a: u32, b: u32, both: u32) -> f64 {
        let h = |count: u32| self.x_ln_x[count as usize];
        let (only_a, only_b) = (a - both, b - both);
        let neither = self.images - a - only_b;
        let joint = h(both) + h(neither) + (h(only_a) + h(only_b));
        let apart = (h(a) + h(b)) + (h(self.images - a) + h(self.images - b));
        (joint - apart + h(self.images)) / f64::from(self.images)
    }

    fn smoothed(&self, seen: u32, images: u32, prior: f64) -> f64 {
        (f64::from(seen) + self.prior_images * prior) / (f64::from(images) + self.prior_images)
    }

    fn dependence(&self, word: WordId, edge: Option<Edge>) -> WordDependence {
        let seen = self.seen[word as usize];
        let marginal = self.smoothed(seen, self.images, self.mean_rate);
        let Some(Edge { parent, both, .. }) = edge else {
            let (given_parent_seen, given_parent_unseen) = (marginal, marginal);
            return WordDependence { parent: word, marginal, given_parent_seen, given_parent_unseen };
        };
        let parent_seen = self.seen[parent as usize];
        WordDependence {
            parent,
            marginal,
            given_parent_seen: self.smoothed(both, parent_seen, marginal),
            given_parent_unseen: self.smoothed(seen - both, self.images - parent_seen, marginal),
        }
    }
}

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

/// Images counted before it is asked whether the observer should hear of it.
const IMAGES_PER_STEP: usize = 4096;

/// Words looked at between two calls of the observer: a tenth of a second or so.
const WORDS_PER_REPORT: u64 = 1 << 24;

/// Prim's algorithm from the most frequent word of each component; `None` for roots.
fn maximum_spanning_forest(
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
    let mut roots: Vec<WordId> = (0..).take(words).collect();
    roots.sort_by_key(|&word| (std::cmp::Reverse(statistics.seen[word as usize]), word));
    for root in roots {
        if joined[root as usize] {
            continue;
        }
        candidates.push(Candidate { mutual_information_nats: 0.0, word: root });
        while let Some(Candidate { word, .. }) = candidates.pop() {
            if std::mem::replace(&mut joined[word as usize], true) {
                continue;
            }
            for images in statistics.images_of(word).chunks(IMAGES_PER_STEP) {
                progress.report(observer)?;
                progress.done += co_occurrences.count(images, observations, &joined);
            }
            for (other, both) in co_occurrences.drain() {
                let (seen, other_seen) = (statistics.seen[word as usize], statistics.seen[other as usize]);
                let mutual_information_nats = statistics.mutual_information_nats(seen, other_seen, both);
                let edge = Edge { parent: word, both, mutual_information_nats };
                if mutual_information_nats > 0.0 && improves(&edge, best[other as usize].as_ref()) {
                    best[other as usize] = Some(edge);
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
    /// Of `done`, how much the observer has heard of; `None` before it has heard anything.
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

    /// Counts the words of these images that have not joined yet; returns how many words it looked at.
    fn count(&mut self, images: &[u32], observations: &[Observation], joined: &[bool]) -> u64 {
        let mut looked_at = 0;
        for &image in images {
            let words = observations[image as usize].words();
            looked_at += words.len() as u64;
            for &other in words {
                if joined[other as usize] {
                    continue;
                }
                let count = &mut self.counts[other as usize];
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
        self.met.drain(..).map(|other| (other, std::mem::take(&mut counts[other as usize])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn observations(images: &[Vec<WordId>], words: usize) -> Vec<Observation> {
        images.iter().map(|image| Observation::from_words(image.iter().copied(), words).unwrap()).collect()
    }

    fn train(images: &[Vec<WordId>], words: usize) -> ChowLiuTree {
        let settings = TreeTrainingSettings::default();
        ChowLiuTree::train(&observations(images, words), words, settings, &mut |_| ControlFlow::Continue(()))
            .unwrap()
    }

    /// From the definition, one state at a time.
    fn plain_mutual_information(images: &[Vec<WordId>], a: WordId, b: WordId) -> f64 {
        let share = |test: &dyn Fn(&Vec<WordId>) -> bool| {
            images.iter().filter(|image| test(image)).count() as f64 / images.len() as f64
        };
        let mut sum = 0.0;
        for (x, y) in [(false, false), (false, true), (true, false), (true, true)] {
            let joint = share(&|image| image.contains(&a) == x && image.contains(&b) == y);
            if joint > 0.0 {
                let apart = share(&|image| image.contains(&a) == x) * share(&|image| image.contains(&b) == y);
                sum += joint * (joint / apart).ln();
            }
        }
        sum
    }

    /// Kruskal over all pairs that met.
    fn brute_force_total(images: &[Vec<WordId>], words: usize) -> f64 {
        let mut edges = Vec::new();
        for a in 0..words as u32 {
            for b in 0..a {
                if images.iter().any(|image| image.contains(&a) && image.contains(&b)) {
                    edges.push((plain_mutual_information(images, a, b), a, b));
                }
            }
        }
        edges.sort_by(|x, y| y.0.total_cmp(&x.0));
        let mut component: Vec<usize> = (0..words).collect();
        let mut total = 0.0;
        for (mutual_information, a, b) in edges {
            let (from, to) = (component[a as usize], component[b as usize]);
            if from != to {
                total += mutual_information;
                component.iter_mut().filter(|c| **c == from).for_each(|c| *c = to);
            }
        }
        total
    }

    proptest! {
        #[test]
        fn the_forest_has_the_most_information_of_all(
            images in proptest::collection::vec(proptest::collection::vec(0..12u32, 0..7), 1..25),
        ) {
            let tree = train(&images, 12);
            let total: f64 = (0..12)
                .filter_map(|word| tree.parent(word).map(|parent| plain_mutual_information(&images, word, parent)))
                .sum();
            let best = brute_force_total(&images, 12);
            prop_assert!((total - best).abs() < 1e-9, "{total} against {best}");
        }

        #[test]
        fn probabilities_never_reach_0_or_1_and_keep_rare_words_rare(
            images in proptest::collection::vec(proptest::collection::vec(0..6u32, 0..6), 1..40),
        ) {
            let tree = train(&images, 6);
            for word in 0..6 {
                let seen = images.iter().filter(|image| image.contains(&word)).count() as f64;
                let marginal = tree.marginal(word, true);
                prop_assert!(marginal > 0.0 && marginal < 1.0);
                // One image of prior moves a rate by less than one image.
                prop_assert!((marginal * images.len() as f64 - seen).abs() <= 1.0);
            }
        }
    }

    #[test]
    fn words_that_never_meet_are_roots_of_their_own() {
        let tree = train(&[vec![0, 1], vec![0, 1], vec![2], vec![2, 3], vec![3], vec![]], 5);
        assert_eq!((tree.parent(0), tree.parent(1)), (None, Some(0)));
        assert!(tree.parent(2).is_none() || tree.parent(3).is_none());
        assert_eq!(tree.parent(4), None);
    }

    #[test]
    fn conditionals_are_counts_with_a_prior_of_one_image() {
        let tree = train(&[vec![0, 1], vec![0, 1], vec![0], vec![]], 2);
        let marginal = (2.0 + (5.0 + 1.0) / (8.0 + 2.0)) / 5.0;
        assert!((tree.marginal(1, true) - marginal).abs() < 1e-15);
        assert!((tree.conditional(1, true, true) - (2.0 + marginal) / 4.0).abs() < 1e-15);
        assert!((tree.conditional(1, true, false) - (0.0 + marginal) / 2.0).abs() < 1e-15);
    }

    #[test]
    fn what_cannot_be_learnt_from_is_refused() {
        let settings = TreeTrainingSettings::default();
        let go_on = &mut |_| ControlFlow::Continue(());
        let images = observations(&[vec![3]], 4);
        let refused =
            |settings, images: &[Observation], words| ChowLiuTree::train(images, words, settings, go_on);
        let mut refused = refused;
        assert_eq!(refused(settings, &[], 4), Err(TreeTrainingError::NoObservations));
        let unknown = TreeTrainingError::UnknownWord { observation: 0, word: 3, words: 2 };
        assert_eq!(refused(settings, &images, 2), Err(unknown));
        let prior = TreeTrainingSettings { prior_images: 0.0 };
        assert_eq!(refused(prior, &images, 4), Err(TreeTrainingError::Prior { prior_images: 0.0 }));
    }

    #[test]
    fn training_can_be_cancelled() {
        let images = observations(&[vec![0, 1]], 2);
        let cancelled =
            ChowLiuTree::train(&images, 2, TreeTrainingSettings::default(), &mut |_| ControlFlow::Break(()));
        assert_eq!(cancelled, Err(TreeTrainingError::Cancelled));
    }
}
