//! Which images of a map can be matched from which: a map without any metres.
//!
//! Nodes are panoramic images. Two are linked where their similarity S is above
//! [`LINK_SIMILARITY`]: matches that one planar motion explains, over the smaller number of
//! features. A link is 1 / S long, so that the shortest path goes over views with much in common
//! (Booij, Terwijn, Zivkovic & Kröse, ICRA 2007). Images come one by one, each compared with all
//! earlier ones, or with those that an index and the links so far promise a link with
//! ([`candidates`]).

pub mod candidates;
mod promise;
mod spaces;

use std::collections::BTreeMap;

use posegraph::shortest_paths::{ShortestPaths, Step};

use crate::appearance::epipolar::PlanarMotion;

/// An image of the map: numbered from 0 as they came.
pub type ImageId = u32;

/// Similarity above which two images are linked.
pub const LINK_SIMILARITY: f64 = 0.05;

/// Matches that one motion has to explain for two images to have anything in common: up to six of a
/// hundred wrong ones agree by chance.
pub const MIN_CONSTRAINED: u32 = 8;

/// What two panoramic images have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Matches that the motion explains.
    pub constrained: u32,
    /// Features of the image that has fewer.
    pub features: u32,
    /// From the current image to the other.
    pub motion: PlanarMotion,
}

impl Overlap {
    /// S, in [0, 1]; 0 if fewer than [`MIN_CONSTRAINED`] matches agree, however few features there
    /// are.
    #[must_use]
    pub fn similarity(&self) -> f64 {
        if self.constrained < MIN_CONSTRAINED {
            return 0.0;
        }
        f64::from(self.constrained) / f64::from(self.features.max(1))
    }
}

/// Compares one panoramic image, that which the robot sees or which comes to the map, with those of
/// the map; the holder of features implements it.
pub trait Panorama {
    /// What the image and one of the map have in common; `None` if no motion joins them.
    fn overlap(&self, image: ImageId) -> Option<Overlap>;
}

/// With which images a new one is compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Checks<'a> {
    /// With all.
    All,
    /// With those that are likely to be similar, by what its features vote for each image
    /// ([`candidates::CandidateIndex::votes`]) and by the links that it has been found to have so
    /// far: the likeliest first, down to six in a thousand.
    Promising(&'a [f64]),
}

/// An image that has come to the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Added {
    /// Its number.
    pub image: ImageId,
    /// How many images it was compared with.
    pub checks: usize,
}

/// A link as one of its ends has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// The other end.
    pub to: ImageId,
    /// S, above [`LINK_SIMILARITY`].
    pub similarity: f64,
}

/// Images and the links between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AppearanceGraph {
    /// By image, in the order in which they came.
    links: Vec<Vec<Link>>,
}

/// How far all images are from one of them.
#[derive(Clone, Debug, PartialEq)]
pub struct GoalDistances {
    goal: ImageId,
    /// Sum of 1 / S; infinite where no path leads.
    distances: Vec<f64>,
}

/// No image of the graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no image {image}; the map has {images}")]
pub struct NoSuchImage {
    /// The number asked for.
    pub image: ImageId,
    /// How many there are.
    pub images: usize,
}

impl AppearanceGraph {
    /// Adds an image and links it to those that it is similar to, of those that it is compared
    /// with.
    pub fn add(&mut self, panorama: &impl Panorama, checks: Checks<'_>) -> Added {
        let similarity = |image| panorama.overlap(image).map_or(0.0, |overlap| overlap.similarity());
        let found: BTreeMap<ImageId, f64> = match checks {
            Checks::All => (0..self.len() as ImageId).map(|image| (image, similarity(image))).collect(),
            Checks::Promising(votes) => promise::compared(self, votes, similarity),
        };
        let image = self.add_image();
        let checks = found.len();
        for (other, similarity) in found {
            self.link(image, other, similarity);
        }
        Added { image, checks }
    }

    /// Adds an image without links.
    pub fn add_image(&mut self) -> ImageId {
        self.links.push(Vec::new());
        (self.links.len() - 1) as ImageId
    }

    /// Links two images if they are similar enough; a pair that is linked already, or none, stays
    /// as it is.
    pub fn link(&mut self, a: ImageId, b: ImageId, similarity: f64) {
        let is_known = |image: ImageId| (image as usize) < self.links.len();
        let is_new = a != b && is_known(a) && is_known(b) && self.similarity(a, b).is_none();
        if is_new && similarity > LINK_SIMILARITY {
            self.links[a as usize].push(Link { to: b, similarity });
            self.links[b as usize].push(Link { to: a, similarity });
        }
    }

    /// Number of images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Whether there are no images yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// Links of an image; none if there is no such image.
    #[must_use]
    pub fn neighbours(&self, image: ImageId) -> &[Link] {
        self.links.get(image as usize).map_or(&[], Vec::as_slice)
    }

    /// S of a linked pair.
    #[must_use]
    pub fn similarity(&self, a: ImageId, b: ImageId) -> Option<f64> {
        self.neighbours(a).iter().find(|link| link.to == b).map(|link| link.similarity)
    }

    /// All links, each once: the earlier image first.
    pub fn links(&self) -> impl Iterator<Item = (ImageId, Link)> + '_ {
        (0..).zip(&self.links).flat_map(|(from, links): (ImageId, _)| {
            links.iter().filter(move |link| from < link.to).map(move |link| (from, *link))
        })
    }

    /// How far each image is from a goal, by links that are 1 / S long.
    ///
    /// # Errors
    /// [`NoSuchImage`] if the goal is none.
    pub fn distances_to(&self, goal: ImageId) -> Result<GoalDistances, NoSuchImage> {
        if goal as usize >= self.len() {
            return Err(NoSuchImage { image: goal, images: self.len() });
        }
        let mut paths = ShortestPaths::new(self.len());
        let steps = |image: usize| {
            let links = self.links[image].iter();
            links.map(|link| Step { to: link.to as usize, length: 1.0 / link.similarity, edge: 0 })
        };
        paths.search([goal as usize], |_| false, steps);
        Ok(GoalDistances { goal, distances: paths.lengths().to_vec() })
    }

    /// Images by convex space, such as a room: groups within which most can be matched from most.
    /// By image, numbered from 0 in the order of their first images.
    ///
    /// Recursive normalised cuts (Shi & Malik, PAMI 2000), as Zivkovic, Booij & Kröse found rooms
    /// ("From images to rooms", Robotics and Autonomous Systems 2007): a part is cut in two while
    /// that costs less than [`MAX_SPACE_CUT`]. Images that no link joins are spaces of their own.
    #[must_use]
    pub fn convex_spaces(&self) -> Vec<u32> {
        spaces::convex_spaces(self, MAX_SPACE_CUT)
    }

    /// The images of the room that an image was taken in, ascending, that one included: those of its
    /// space from which at least [`MIN_ROOM_SHARE`] of what can be matched from it can be matched, by
    /// similarity, and the same the other way round. A space that is not cut at a door reaches some
    /// metres into the hall, from where little of the room is seen, or much besides. `spaces` is what
    /// [`convex_spaces`](Self::convex_spaces) gave; empty if there is no such image.
    #[must_use]
    pub fn room_around(&self, image: ImageId, spaces: &[u32]) -> Vec<ImageId> {
        spaces::room_around(self, image, spaces, MIN_ROOM_SHARE)
    }
}

/// Share of what is matched from an image in a room that must be matched from another for it to be in the room, too, and
/// of what is matched from that one: a room is seen whole from within and in part through its door, and whoever stands
/// before the door sees the hall as well.
pub const MIN_ROOM_SHARE: f64 = 0.7;

/// Normalised cut, in [0, 2], below which a part of the graph is two spaces: a door lets through
/// that share of what is seen of each room. Where a map has only the places of one way through
/// a building, a room is a few places, and the two or three in its door weigh much: below 0.4 such rooms
/// stay with their hall.
pub const MAX_SPACE_CUT: f64 = 0.5;

impl GoalDistances {
    /// The image that is 0 away.
    #[must_use]
    pub fn goal(&self) -> ImageId {
        self.goal
    }

    /// Sum of 1 / S along the shortest path; `None` if none leads there.
    #[must_use]
    pub fn of(&self, image: ImageId) -> Option<f64> {
        self.distances.get(image as usize).copied().filter(|distance| distance.is_finite())
    }

    /// The first link of the shortest path from an image; `None` at the goal, and where no path
    /// leads there.
    #[must_use]
    pub fn next(&self, graph: &AppearanceGraph, from: ImageId) -> Option<Link> {
        let through = |link: &Link| Some((self.of(link.to)? + 1.0 / link.similarity, *link));
        let ways = graph.neighbours(from).iter().filter_map(through).filter(|_| from != self.goal);
        ways.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, link)| link)
    }

    /// The images of the shortest path from one to the goal, both among them; empty if there is
    /// none.
    #[must_use]
    pub fn path(&self, graph: &AppearanceGraph, from: ImageId) -> Vec<ImageId> {
        if self.of(from).is_none() {
            return Vec::new();
        }
        let mut path = vec![from];
        while let Some(link) = path.last().and_then(|&here| self.next(graph, here)) {
            path.push(link.to);
        }
        path
    }
}

#[cfg(test)]
mod tests;
