//! The synthetic workload: sparse binary images of a tree of words, of any size, by seed.
//!
//! The model is that of the numpy generator that the baselines were measured with: marginals by a Zipf-Mandelbrot law, words coupled to a slightly more frequent
//! parent, a place an image of that distribution, a revisit half of the place's words and half of
//! another image's. Random numbers are drawn otherwise, so equal seeds give other images of the
//! same distribution.

mod model;

use std::collections::BTreeSet;

use anyhow::Result;
use fabmap::chow_liu::{ChowLiuTree, WordDependence};
use fabmap::observation::{Observation, WordId};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::error::refused;

/// What the images are like; the defaults are those of the baselines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WorkloadSettings {
    /// V: words of the vocabulary, at least 1.
    pub words: u32,
    /// Mean number of words in an image; at most half the vocabulary, as no word is more frequent
    /// than 0.5.
    pub words_per_image: f64,
    /// s of the marginals c (q + q0)^-s.
    pub zipf_exponent: f64,
    /// q0 of the marginals, above 0.
    pub zipf_offset: f64,
    /// How much a seen parent adds: p(q|1) = p + boost (1 - p), in [0, 1].
    pub boost: f64,
    /// Probability that a revisit shows a word of the place, and one less that it shows a word of
    /// another image; in [0, 1].
    pub kept_share: f64,
    /// Seed of the tree and of all images.
    pub seed: u64,
}

impl Default for WorkloadSettings {
    fn default() -> Self {
        Self {
            words: 10_000,
            words_per_image: 300.0,
            zipf_exponent: 0.8,
            zipf_offset: 50.0,
            boost: 0.3,
            kept_share: 0.5,
            seed: 20_240_607,
        }
    }
}

/// The distribution that images are drawn from. The image of a number is always the same, however
/// many are drawn and on however many threads.
#[derive(Clone, Debug)]
pub(crate) struct Workload {
    settings: WorkloadSettings,
    tree: ChowLiuTree,
    /// p(z_q = 1 | z_pq = 0): with which a word is seen whatever its parent.
    spontaneous: Vec<f64>,
    /// The largest of each [`BLOCK_WORDS`] of `spontaneous`.
    most_spontaneous: Vec<f64>,
}

/// What an image is drawn for; images of different uses are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// A place on the map.
    Place = 1,
    /// One of the training images.
    Training = 2,
    /// A query from a place nobody has seen.
    NewQuery = 3,
    /// What a revisit shows besides its place.
    Change = 4,
}

/// A revisit: what was seen and where.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Revisit {
    /// The place visited.
    pub place: u32,
    /// What is seen there this time.
    pub observation: Observation,
}

/// Streams of the tree, and of the choices of each revisit and each place's looks; those of images are a [`Use`].
const TREE_STREAM: u64 = 0;
const REVISIT_STREAM: u64 = 5;
const LOOK_STREAM: u64 = 6;

/// No word is more frequent.
const MAX_MARGINAL: f64 = 0.5;
/// p(z_q = 1 | z_pq = 1) is at most this, as far as the boost goes.
const MAX_GIVEN_SEEN: f64 = 0.95;
/// p(z_q = 1 | z_pq = 0) keeps this share of the marginal.
const MIN_UNSEEN_SHARE: f64 = 0.2;

/// Words whose spontaneous ones are found by one rate.
const BLOCK_WORDS: usize = 128;

impl Workload {
    /// The distribution of these settings.
    pub(crate) fn new(settings: WorkloadSettings) -> Result<Self> {
        let most = MAX_MARGINAL * f64::from(settings.words);
        if !(settings.words_per_image > 0.0 && settings.words_per_image <= most) {
            let WorkloadSettings { words, words_per_image, .. } = settings;
            return Err(refused(format_args!(
                "images of {words_per_image} words cannot be had of {words}; give a vocabulary of at least twice the \
                 words of an image"
            )));
        }
        let marginals = marginals(&settings);
        let mut random = stream(settings.seed, TREE_STREAM, 0);
        let rows = marginals.iter().enumerate().map(|(word, &marginal)| {
            if word == 0 {
                return WordDependence {
                    parent: WordId::new(0),
                    marginal,
                    given_parent_seen: marginal,
                    given_parent_unseen: marginal,
                };
            }
            let parent = random.random_range(word / 2..word);
            coupled(WordId::from_index(parent), marginal, marginals[parent], settings.boost)
        });
        Ok(Self::over(settings, ChowLiuTree::from_rows(rows).map_err(refused)?))
    }

    fn over(settings: WorkloadSettings, tree: ChowLiuTree) -> Self {
        let words = WordId::first(tree.len());
        let spontaneous: Vec<f64> = words.map(|word| tree.conditional(word, true, false)).collect();
        let largest = |block: &[f64]| block.iter().copied().fold(0.0, f64::max);
        let most_spontaneous = spontaneous.chunks(BLOCK_WORDS).map(largest).collect();
        Self { settings, tree, spontaneous, most_spontaneous }
    }

    /// The tree that the images come from.
    pub(crate) fn tree(&self) -> &ChowLiuTree {
        &self.tree
    }

    /// The first `count` images of a use.
    pub(crate) fn images(&self, of: Use, count: u32) -> Vec<Observation> {
        (0..count).into_par_iter().map(|index| self.image(of, index)).collect()
    }

    /// One image: an ancestral sample of the tree.
    pub(crate) fn image(&self, of: Use, index: u32) -> Observation {
        let words = self.draw(&mut stream(self.settings.seed, of as u64, index));
        self.observation(words)
    }

    /// Revisit number `index` of a uniformly chosen one of the first `places` images for a map, at least 1: each of
    /// the place's words with probability `kept_share`, and the words of a fresh image each with probability
    /// 1 - `kept_share`.
    pub(crate) fn revisit_to_one_of(&self, index: u32, places: u32) -> Revisit {
        let mut random = stream(self.settings.seed, REVISIT_STREAM, index);
        let place = random.random_range(0..places as usize) as u32;
        let observation = self.changed(&self.image(Use::Place, place), index, &mut random);
        Revisit { place, observation }
    }

    /// A revisit to a given place.
    pub(crate) fn revisit_to(&self, index: u32, place: u32) -> Observation {
        let mut random = stream(self.settings.seed, REVISIT_STREAM, index);
        self.changed(&self.image(Use::Place, place), index, &mut random)
    }

    /// What is seen of a place in `looks` looks, at least 1: all of it, then each of its words with
    /// probability `kept_share`. So a place has the same words however often it is looked at.
    pub(crate) fn looks(&self, place: u32, looks: u8) -> Vec<Observation> {
        let whole = self.image(Use::Place, place);
        let mut random = stream(self.settings.seed, LOOK_STREAM, place);
        let kept_share = self.settings.kept_share;
        let later = (1..looks)
            .map(|_| self.observation(thinned(&whole, kept_share, &mut random)))
            .collect::<Vec<_>>();
        std::iter::once(whole).chain(later).collect()
    }

    fn changed(&self, place: &Observation, index: u32, random: &mut ChaCha8Rng) -> Observation {
        let change = self.image(Use::Change, index);
        let kept_share = self.settings.kept_share;
        let mut words = thinned(place, kept_share, random);
        words.extend(thinned(&change, 1.0 - kept_share, random));
        words.sort_unstable();
        words.dedup();
        self.observation(words)
    }

    /// A word is seen with p(z_q = 1 | z_pq = 0) whatever its parent, or because of its parent with
    /// what is missing to p(z_q = 1 | z_pq = 1), which is never less here. Takes time in proportion to
    /// the words seen, not to the vocabulary.
    fn draw(&self, random: &mut ChaCha8Rng) -> Vec<WordId> {
        let mut words = self.draw_spontaneous(random);
        let mut seen: BTreeSet<WordId> = words.iter().copied().collect();
        while let Some(word) = words.pop() {
            for &child in self.tree.children(word) {
                let unseen = self.spontaneous[child.index()];
                let because_of_parent = (self.tree.conditional(child, true, true) - unseen) / (1.0 - unseen);
                if random.random::<f64>() < because_of_parent && seen.insert(child) {
                    words.push(child);
                }
            }
        }
        seen.into_iter().collect()
    }

    /// Jumps from word to word by the geometric distribution of a block's largest rate, and keeps each
    /// with its own share of that.
    fn draw_spontaneous(&self, random: &mut ChaCha8Rng) -> Vec<WordId> {
        let mut words = Vec::new();
        let blocks = self.spontaneous.chunks(BLOCK_WORDS).zip(&self.most_spontaneous);
        for (first, (block, &rate)) in (0..).step_by(BLOCK_WORDS).zip(blocks) {
            let mut position = 0;
            loop {
                let uniform = 1.0 - random.random::<f64>();
                position += (uniform.ln() / (1.0 - rate).ln()) as usize;
                let Some(&own) = block.get(position) else { break };
                if random.random::<f64>() * rate < own {
                    words.push(WordId::from_index(first + position));
                }
                position += 1;
            }
        }
        words
    }

    fn observation(&self, words: Vec<WordId>) -> Observation {
        let Ok(observation) = Observation::from_words(words, self.tree.len()) else {
            unreachable!("words are drawn from the tree")
        };
        observation
    }
}

/// min(0.5, c (q + q0)^-s) with c such that they sum to the words of an image.
fn marginals(settings: &WorkloadSettings) -> Vec<f64> {
    let base: Vec<f64> = (0..settings.words)
        .map(|rank| (f64::from(rank) + settings.zipf_offset).powf(-settings.zipf_exponent))
        .collect();
    let sum = |scale: f64| base.iter().map(|base| (scale * base).min(MAX_MARGINAL)).sum::<f64>();
    let mut below = 0.0;
    let mut above = 1e9;
    for _ in 0..200 {
        let middle = 0.5 * (below + above);
        if sum(middle) > settings.words_per_image { above = middle } else { below = middle }
    }
    base.iter().map(|base| (below * base).min(MAX_MARGINAL)).collect()
}

/// A word that its parent makes more likely, its marginal unchanged.
fn coupled(parent: WordId, marginal: f64, parent_marginal: f64, boost: f64) -> WordDependence {
    let most = (marginal - MIN_UNSEEN_SHARE * marginal * (1.0 - parent_marginal)) / parent_marginal;
    let given_parent_seen = (marginal + boost * (1.0 - marginal)).min(MAX_GIVEN_SEEN).min(most);
    let given_parent_unseen = (marginal - given_parent_seen * parent_marginal) / (1.0 - parent_marginal);
    WordDependence { parent, marginal, given_parent_seen, given_parent_unseen }
}

fn thinned(observation: &Observation, share: f64, random: &mut ChaCha8Rng) -> Vec<WordId> {
    observation.words().iter().copied().filter(|_| random.random::<f64>() < share).collect()
}

/// Random numbers of their own for every number of every use.
fn stream(seed: u64, of: u64, index: u32) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(of << 32 | u64::from(index));
    random
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small, but with the frequent and rare words, and as strongly coupled, as the large one.
    fn small() -> Workload {
        let settings = WorkloadSettings { words: 400, words_per_image: 40.0, ..WorkloadSettings::default() };
        Workload::new(settings).unwrap()
    }

    const IMAGES: u32 = 20_000;

    /// Six standard deviations of a share of so many trials.
    fn tolerance(probability: f64, trials: f64) -> f64 {
        6.0 * (probability * (1.0 - probability) / trials).sqrt() + 1e-9
    }

    #[test]
    fn marginals_follow_the_law_and_sum_to_the_words_of_an_image() {
        let settings = WorkloadSettings::default();
        let marginals = marginals(&settings);
        assert!((marginals.iter().sum::<f64>() - 300.0).abs() < 1e-6);
        assert!(marginals.iter().all(|&p| p > 0.0 && p <= 0.5));
        let law = |rank: f64| (rank + 50.0).powf(-0.8);
        let ratio = marginals[9_000] / marginals[1_000];
        assert!((ratio - law(9_000.0) / law(1_000.0)).abs() < 1e-9, "{ratio}");
    }

    #[test]
    fn the_tree_keeps_the_marginals() {
        let workload = small();
        let tree = workload.tree();
        for word in WordId::first(400).skip(1) {
            let parent = tree.parent(word).unwrap();
            assert!((word.number() / 2..word.number()).contains(&parent.number()));
            let (p, pp) = (tree.marginal(word, true), tree.marginal(parent, true));
            let (seen, unseen) = (tree.conditional(word, true, true), tree.conditional(word, true, false));
            assert!((seen * pp + unseen * (1.0 - pp) - p).abs() < 1e-12);
            assert!(seen > p && seen <= (p + 0.3 * (1.0 - p)).min(0.95) + 1e-12 && unseen >= 0.2 * p - 1e-12);
        }
        assert_eq!(tree.parent(WordId::new(0)), None);
    }

    #[test]
    fn images_are_drawn_from_the_tree() {
        let workload = small();
        let images = workload.images(Use::Training, IMAGES);
        let tree = workload.tree();
        let words = images.iter().map(Observation::len).sum::<usize>() as f64 / f64::from(IMAGES);
        assert!((words - 40.0).abs() < 0.5, "{words} words an image");
        for word in WordId::first(400) {
            let parent = tree.parent(word).unwrap_or(word);
            let (mut given, mut seen) = ([0.0; 2], [0.0; 2]);
            for image in &images {
                let parent_seen = usize::from(image.contains(parent) && parent != word);
                given[parent_seen] += 1.0;
                seen[parent_seen] += f64::from(u8::from(image.contains(word)));
            }
            for (parent_seen, (given, seen)) in [false, true].into_iter().zip(given.into_iter().zip(seen)) {
                let expected = tree.conditional(word, true, parent_seen);
                let share = if given > 0.0 { seen / given } else { expected };
                assert!(
                    (share - expected).abs() <= tolerance(expected, given),
                    "word {word}: {share} {expected}"
                );
            }
        }
    }

    #[test]
    fn a_revisit_is_half_the_place_and_half_another_image() {
        let workload = small();
        let places = workload.images(Use::Place, 50);
        let revisits: Vec<Revisit> = (0..IMAGES).map(|index| workload.revisit_to_one_of(index, 50)).collect();
        // p(z | place) = 1 - (1 - kept l)(1 - (1 - kept) p), word by word.
        for word in [0, 7, 150, 399].map(WordId::new) {
            let marginal = workload.tree().marginal(word, true);
            for there in [false, true] {
                let at = |revisit: &&Revisit| places[revisit.place as usize].contains(word) == there;
                let trials = revisits.iter().filter(at).count() as f64;
                let seen = revisits.iter().filter(at).filter(|r| r.observation.contains(word)).count() as f64;
                let kept = if there { 0.5 } else { 0.0 };
                let expected = 1.0 - (1.0 - kept) * (1.0 - 0.5 * marginal);
                assert!((seen / trials - expected).abs() <= tolerance(expected, trials), "{word} {there}");
            }
        }
        let visited: BTreeSet<u32> = revisits.iter().map(|revisit| revisit.place).collect();
        assert_eq!(visited.len(), places.len());
    }

    #[test]
    fn an_image_is_its_seed_use_and_number() {
        let (workload, again) = (small(), small());
        let images = workload.images(Use::Place, 30);
        assert_eq!(images[..10], again.images(Use::Place, 10)[..]);
        assert_ne!(images, workload.images(Use::NewQuery, 30));
        assert_eq!(workload.revisit_to_one_of(3, 30), again.revisit_to_one_of(3, 30));
        let words = images[7].words();
        let looks = workload.looks(7, 4);
        assert!(looks[0] == images[7] && looks.len() == 4);
        assert!(looks.iter().all(|look| look.words().iter().all(|word| words.contains(word))));
        assert_ne!(looks[1], looks[2]);
        assert_ne!(workload.revisit_to(3, 7), workload.revisit_to(4, 7));
        let other = Workload::new(WorkloadSettings { seed: 1, ..workload.settings }).unwrap();
        assert_ne!(other.tree(), workload.tree());
    }

    #[test]
    fn settings_that_make_no_distribution_are_refused() {
        let refused = |settings| Workload::new(settings).is_err();
        assert!(refused(WorkloadSettings { words: 0, ..WorkloadSettings::default() }));
        assert!(refused(WorkloadSettings { words_per_image: 0.0, ..WorkloadSettings::default() }));
        assert!(refused(WorkloadSettings { words: 599, ..WorkloadSettings::default() }));
        assert!(refused(WorkloadSettings { boost: -2.0, ..WorkloadSettings::default() }));
    }
}
