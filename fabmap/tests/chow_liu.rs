//! The tree over two thousand words holds as much information as the best one found by brute force.
#![expect(clippy::unwrap_used, reason = "a test's own images are valid")]

use std::ops::ControlFlow;

use fabmap::chow_liu::{ChowLiuTree, TreeTrainingSettings};
use fabmap::observation::{Observation, WordId};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WORDS: usize = 2_000;
const IMAGES: usize = 1_500;

/// Images whose words come together: each word brings one of a few others along.
fn images() -> Vec<Observation> {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut image = || {
        let mut words = Vec::new();
        for _ in 0..60 {
            // Squared, so that some words are far more frequent than others.
            let word = (random.random::<f64>().powi(2) * WORDS as f64) as u32;
            words.push(word);
            if random.random_bool(0.7) {
                words.push((word * 7 + random.random_range(0..3)) % WORDS as u32);
            }
        }
        Observation::from_words(words, WORDS).unwrap()
    };
    (0..IMAGES).map(|_| image()).collect()
}

/// One bit for each image that shows the word.
fn bits(images: &[Observation]) -> Vec<Vec<u64>> {
    let mut bits = vec![vec![0u64; IMAGES.div_ceil(64)]; WORDS];
    for (image, observation) in images.iter().enumerate() {
        for &word in observation.words() {
            bits[word.index()][image / 64] |= 1 << (image % 64);
        }
    }
    bits
}

/// Σ p(x, y) ln [p(x, y) / (p(x) p(y))] over the four states; `None` for words that never meet.
fn mutual_information_nats(a: &[u64], b: &[u64]) -> Option<f64> {
    let count = |bits: &mut dyn Iterator<Item = u64>| bits.map(u64::count_ones).sum::<u32>();
    let both = count(&mut a.iter().zip(b).map(|(a, b)| a & b));
    let (seen_a, seen_b) = (count(&mut a.iter().copied()), count(&mut b.iter().copied()));
    if both == 0 {
        return None;
    }
    let images = IMAGES as f64;
    let share = |count: u32| f64::from(count) / images;
    let (p_a, p_b) = (share(seen_a), share(seen_b));
    let states = [
        (share(both), p_a * p_b),
        (share(seen_a - both), p_a * (1.0 - p_b)),
        (share(seen_b - both), (1.0 - p_a) * p_b),
        (share(IMAGES as u32 + both - seen_a - seen_b), (1.0 - p_a) * (1.0 - p_b)),
    ];
    Some(
        states
            .iter()
            .filter(|(joint, _)| *joint > 0.0)
            .map(|(joint, apart)| joint * (joint / apart).ln())
            .sum(),
    )
}

/// Kruskal's algorithm over every pair.
fn brute_force_total_nats(bits: &[Vec<u64>]) -> f64 {
    let mut edges = Vec::new();
    for a in 0..WORDS {
        for b in 0..a {
            edges.extend(mutual_information_nats(&bits[a], &bits[b]).map(|nats| (nats, a, b)));
        }
    }
    edges.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut component: Vec<usize> = (0..WORDS).collect();
    let mut total = 0.0;
    for (nats, a, b) in edges {
        let (from, to) = (component[a], component[b]);
        if from != to {
            total += nats;
            component
                .iter_mut()
                .filter(|component| **component == from)
                .for_each(|component| *component = to);
        }
    }
    total
}

#[test]
fn two_thousand_words_hold_as_much_information_as_the_best_tree() {
    let images = images();
    let bits = bits(&images);
    let mut heard = Vec::new();
    let tree = ChowLiuTree::train(&images, WORDS, TreeTrainingSettings::default(), &mut |fraction| {
        heard.push(fraction);
        ControlFlow::Continue(())
    })
    .unwrap();
    let edges = WordId::first(WORDS).filter_map(|word| Some((word, tree.parent(word)?)));
    let total: f64 = edges
        .map(|(word, parent)| mutual_information_nats(&bits[word.index()], &bits[parent.index()]).unwrap())
        .sum();
    let best = brute_force_total_nats(&bits);
    assert!(best > 1.0, "the images have something to say: {best} nats");
    assert!((total - best).abs() < 1e-9 * best, "{total} nats against {best}");
    assert!(heard.is_sorted() && heard.iter().all(|fraction| (0.0..=1.0).contains(fraction)), "{heard:?}");
}
