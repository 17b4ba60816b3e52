//! The order in which a new image is compared with others, and when that is enough: each comparison
//! goes to the image that is likeliest to be similar, until none is likely.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use super::{AppearanceGraph, ImageId, LINK_SIMILARITY};

/// Chance of a link below which an image is not compared with.
const LEAST_CHANCE: f64 = 0.006;

/// Images that may be similar, the likeliest first, and those that were compared with.
struct Promises<'a> {
    /// By image; none are 0.
    votes: &'a [f64],
    /// By image: Σ S(new, linked) S(linked, image) over what the new one is linked to.
    support: BTreeMap<ImageId, f64>,
    /// Chances, which are in the order of their bits; one that has grown since is there again.
    queue: BinaryHeap<(u64, Reverse<ImageId>)>,
}

/// Similarities with the images that are worth a comparison.
pub(super) fn compared(
    graph: &AppearanceGraph,
    votes: &[f64],
    similarity: impl Fn(ImageId) -> f64,
) -> BTreeMap<ImageId, f64> {
    let votes = &votes[..votes.len().min(graph.len())];
    let mut promises = Promises { votes, support: BTreeMap::new(), queue: BinaryHeap::new() };
    (0..votes.len() as ImageId).for_each(|image| promises.consider(image));
    let mut found = BTreeMap::new();
    while let Some((_, Reverse(image))) = promises.queue.pop() {
        if found.contains_key(&image) {
            continue;
        }
        let here = similarity(image);
        found.insert(image, here);
        if here > LINK_SIMILARITY {
            for link in graph.neighbours(image) {
                *promises.support.entry(link.to).or_default() += here * link.similarity;
                promises.consider(link.to);
            }
        }
    }
    found
}

impl Promises<'_> {
    fn consider(&mut self, image: ImageId) {
        let vote = self.votes.get(image as usize).copied().unwrap_or(0.0);
        let chance = link_chance(vote, self.support.get(&image).copied().unwrap_or(0.0));
        if chance >= LEAST_CHANCE {
            self.queue.push((chance.to_bits(), Reverse(image)));
        }
    }
}

/// How likely an image is to be similar, by the vote for it and by its links with what is known to
/// be similar.
///
/// A logistic regression over all pairs of 600 panoramas of a simulated building, of 300 and of 500
/// features, with words of such panoramas and of a camera that looks ahead. It holds in other
/// buildings and with 500 words, too.
fn link_chance(vote: f64, support: f64) -> f64 {
    let log_odds = 23.6 + 4.08 * (vote + 0.002).ln() + 1.39 * (support + 0.01).ln();
    1.0 / (1.0 + (-log_odds).exp())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const IMAGES: u32 = 25;

    /// In each round all images are judged again, and the likeliest one is compared.
    fn plainly(graph: &AppearanceGraph, votes: &[f64], similarities: &[f64]) -> Vec<(ImageId, f64)> {
        let mut found: Vec<(ImageId, f64)> = Vec::new();
        loop {
            let mut best: Option<(f64, ImageId)> = None;
            for image in (0..IMAGES).filter(|image| found.iter().all(|(known, _)| known != image)) {
                let through = |&(known, here): &(ImageId, f64)| {
                    let link = graph.similarity(known, image).filter(|_| here > LINK_SIMILARITY);
                    here * link.unwrap_or(0.0)
                };
                let chance = link_chance(votes[image as usize], found.iter().map(through).sum());
                if chance >= LEAST_CHANCE && best.is_none_or(|(most, _)| chance > most) {
                    best = Some((chance, image));
                }
            }
            let Some((_, image)) = best else { return found };
            found.push((image, similarities[image as usize]));
        }
    }

    proptest! {
        #[test]
        fn comparisons_are_those_of_a_plain_search(
            links in prop::collection::vec((0..IMAGES, 0..IMAGES, 0.051..0.9), 0..120),
            votes in prop::collection::vec(prop_oneof![Just(0.0), 0.0..0.004, 0.0..0.2], IMAGES as usize),
            similarities in prop::collection::vec(prop_oneof![0.0..0.05, 0.04..0.6], IMAGES as usize),
        ) {
            let mut graph = AppearanceGraph::default();
            (0..IMAGES).for_each(|_| { graph.add_image(); });
            links.iter().for_each(|&(a, b, similarity)| graph.link(a, b, similarity));
            let found = compared(&graph, &votes, |image| similarities[image as usize]);
            let mut plain = plainly(&graph, &votes, &similarities);
            plain.sort_by_key(|(image, _)| *image);
            prop_assert_eq!(found.into_iter().collect::<Vec<_>>(), plain);
        }
    }

    #[test]
    fn a_chance_grows_with_votes_and_with_common_neighbours() {
        let votes = [0.0, 0.002, 0.01, 0.05, 0.5];
        for pair in votes.windows(2) {
            assert!(link_chance(pair[0], 0.0) < link_chance(pair[1], 0.0));
            assert!(link_chance(pair[1], 0.0) < link_chance(pair[1], 0.1));
        }
        // Somebody whom nothing speaks for, and somebody whom all does.
        assert!(link_chance(0.0, 0.0) < 1e-3 && link_chance(0.2, 0.2) > 0.99);
    }
}
