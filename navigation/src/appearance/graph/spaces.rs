//! Rooms: where the graph hangs together by little.

use std::collections::BTreeMap;

use super::{AppearanceGraph, ImageId};

/// Steps after which the vector that parts a graph is taken as it is.
const MAX_STEPS: usize = 3000;

/// Change of the vector at which it has settled.
const SETTLED: f64 = 1e-8;

/// A part of the graph by itself: its images, ascending, and their links among each other.
struct Part {
    images: Vec<usize>,
    links: Vec<Vec<(usize, f64)>>,
}

pub(super) fn convex_spaces(graph: &AppearanceGraph, max_cut: f64) -> Vec<u32> {
    let mut open = vec![(0..graph.len()).collect::<Vec<usize>>()];
    let mut spaces: Vec<Vec<usize>> = Vec::new();
    while let Some(images) = open.pop() {
        let part = Part::new(graph, images);
        let pieces = part.connected();
        if pieces.len() > 1 {
            open.extend(pieces);
            continue;
        }
        match part.best_cut() {
            Some((cut, sides)) if cut < max_cut => open.extend(sides),
            Some(_) | None => spaces.push(part.images),
        }
    }
    spaces.sort();
    let mut of_image = vec![0; graph.len()];
    for (space, images) in (0..).zip(&spaces) {
        images.iter().for_each(|&image| of_image[image] = space);
    }
    of_image
}

pub(super) fn room_around(
    graph: &AppearanceGraph,
    image: ImageId,
    spaces: &[u32],
    min_share: f64,
) -> Vec<ImageId> {
    let Some(&space) = spaces.get(image as usize) else { return Vec::new() };
    // What is matched from an image, by similarity; itself as much as what is most similar to it.
    let seen_from = |image: ImageId| {
        let links = graph.neighbours(image);
        let most = links.iter().map(|link| link.similarity).fold(0.0, f64::max);
        links.iter().map(|link| (link.to, link.similarity)).chain([(image, most)]).collect::<Sight>()
    };
    let here = seen_from(image);
    let is_inside = |&other: &ImageId| {
        other == image
            || (spaces[other as usize] == space && {
                let there = seen_from(other);
                share(&here, &there) >= min_share && share(&there, &here) >= min_share
            })
    };
    (0..spaces.len() as ImageId).filter(is_inside).collect()
}

/// Images that are matched from one, with their similarity.
type Sight = BTreeMap<ImageId, f64>;

/// The share of what is matched from one image that is matched from another, too.
fn share(of: &Sight, also_from: &Sight) -> f64 {
    let all: f64 = of.values().sum();
    let shared: f64 =
        of.iter().filter(|(image, _)| also_from.contains_key(image)).map(|(_, part)| part).sum();
    shared / all
}

impl Part {
    fn new(graph: &AppearanceGraph, mut images: Vec<usize>) -> Self {
        images.sort_unstable();
        let links = images.iter().map(|&image| {
            let links = graph.neighbours(image as u32).iter();
            let within =
                |link: &super::Link| Some((images.binary_search(&(link.to as usize)).ok()?, link.similarity));
            links.filter_map(within).collect()
        });
        Self { links: links.collect(), images }
    }

    /// The images of each piece that hangs together.
    fn connected(&self) -> Vec<Vec<usize>> {
        let mut is_seen = vec![false; self.images.len()];
        let mut pieces = Vec::new();
        for start in 0..self.images.len() {
            if std::mem::replace(&mut is_seen[start], true) {
                continue;
            }
            let mut piece = vec![start];
            let mut next = 0;
            while let Some(&image) = piece.get(next) {
                next += 1;
                for &(to, _) in &self.links[image] {
                    if !std::mem::replace(&mut is_seen[to], true) {
                        piece.push(to);
                    }
                }
            }
            pieces.push(piece.into_iter().map(|image| self.images[image]).collect());
        }
        pieces
    }

    /// The cheapest cut along the order of the second eigenvector, and its sides.
    fn best_cut(&self) -> Option<(f64, [Vec<usize>; 2])> {
        let degrees: Vec<f64> =
            self.links.iter().map(|links| links.iter().map(|(_, similarity)| similarity).sum()).collect();
        let order = self.order(&degrees)?;
        let total: f64 = degrees.iter().sum();
        let mut is_before = vec![false; order.len()];
        let mut cut = 0.0;
        let mut before = 0.0;
        let mut best: Option<(f64, usize)> = None;
        for (count, &image) in (1..order.len()).zip(&order) {
            is_before[image] = true;
            before += degrees[image];
            for &(to, similarity) in &self.links[image] {
                cut += if is_before[to] { -similarity } else { similarity };
            }
            let cost = cut / before + cut / (total - before);
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, count));
            }
        }
        let (cost, count) = best?;
        let side = |images: &[usize]| images.iter().map(|&image| self.images[image]).collect();
        Some((cost, [side(&order[..count]), side(&order[count..])]))
    }

    /// Images in the order of the second eigenvector of (I + D^-½ W D^-½) / 2, by power iteration
    /// on what is left beside the first, D^½ 1.
    fn order(&self, degrees: &[f64]) -> Option<Vec<usize>> {
        if self.images.len() < 2 || degrees.iter().any(|&degree| degree <= 0.0) {
            return None;
        }
        let roots: Vec<f64> = degrees.iter().map(|degree| degree.sqrt()).collect();
        let first = unit(roots.clone())?;
        // Any start will do that is not orthogonal to it; this one is as good as random.
        let start = (0..self.images.len()).map(|image| (1.0 + image as f64 * 0.618_033_988_7).fract() - 0.5);
        let mut vector = unit(without(start.collect(), &first))?;
        for _ in 0..MAX_STEPS {
            let next = |image: usize| {
                let links = self.links[image].iter();
                let from_links: f64 =
                    links.map(|&(to, similarity)| similarity * vector[to] / (roots[image] * roots[to])).sum();
                (vector[image] + from_links) / 2.0
            };
            let next = unit(without((0..vector.len()).map(next).collect(), &first))?;
            let change = next.iter().zip(&vector).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            vector = next;
            if change < SETTLED {
                break;
            }
        }
        let value = |image: &usize| vector[*image] / roots[*image];
        let mut order: Vec<usize> = (0..self.images.len()).collect();
        order.sort_by(|a, b| value(a).total_cmp(&value(b)).then(a.cmp(b)));
        Some(order)
    }
}

fn unit(mut vector: Vec<f64>) -> Option<Vec<f64>> {
    let norm = vector.iter().map(|value| value * value).sum::<f64>().sqrt();
    vector.iter_mut().for_each(|value| *value /= norm);
    (norm > 1e-12).then_some(vector)
}

fn without(mut vector: Vec<f64>, first: &[f64]) -> Vec<f64> {
    let along: f64 = vector.iter().zip(first).map(|(a, b)| a * b).sum();
    vector.iter_mut().zip(first).for_each(|(value, first)| *value -= along * first);
    vector
}
