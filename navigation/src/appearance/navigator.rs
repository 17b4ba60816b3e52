//! To a goal by looks alone: no odometry, no metres, a robot that drives where it sees the next
//! image of its path.
//!
//! The robot steers towards a subgoal, the node c. With each observation c moves on to a neighbour
//! that is nearer to the goal and matches, as often as there is one; then the heading is that from
//! the observation to c. Booij, Terwijn, Zivkovic & Kröse, ICRA 2007. Begin with
//! [`AppearanceNavigator::observe`].

mod smoothing;
mod steering;

use std::collections::BTreeMap;

use crate::appearance::graph::{
    AppearanceGraph, GoalDistances, ImageId, LINK_SIMILARITY, Link, NoSuchImage, Overlap, Panorama,
};

pub use smoothing::SmoothedHeading;
pub use steering::HeadingSteering;

/// What the robot sees now.
pub trait Sight: Panorama {
    /// By how much the robot has turned to the left since its last observation, in radians, as far
    /// as the two images tell; `None` if they do not, or this is the first.
    fn turned_rad(&self) -> Option<f64>;

    /// The images among which the robot looks for itself when it does not know where it is: all of
    /// the map, or those that an index names.
    fn relocalization_candidates(&self) -> Vec<ImageId>;
}

/// Whether the robot is free to do as it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// It is.
    Free,
    /// Its own reflex has taken over, or something holds it.
    Held,
}

/// How a navigator decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NavigationSettings {
    /// A neighbour of the subgoal becomes the subgoal itself where it is seen at least so well as
    /// the next image of the shortest path is seen from the subgoal, times this share, in [0, 1];
    /// or where the robot is at the subgoal. With less, far images come into sight sooner than the
    /// way to them is free.
    pub advance_share: f64,
    /// The goal is reached where the similarity with it is this share of its best link's, in [0,
    /// 1].
    pub arrival_share: f64,
    /// Weight of the last heading as against the new one, in [0, 1): each one before weighs as much
    /// less again.
    pub recency: f64,
    /// Observations without a heading after which the robot looks for itself in the whole map.
    pub patience: u32,
    /// Observations in which the subgoal comes no nearer, after which it does so too.
    pub stall_patience: u32,
    /// Neighbours that an observation is compared with at most, the most similar to the subgoal
    /// first.
    pub max_neighbours: usize,
}

impl Default for NavigationSettings {
    fn default() -> Self {
        Self {
            advance_share: 0.95,
            arrival_share: 0.8,
            recency: 0.5,
            patience: 10,
            stall_patience: 24,
            max_neighbours: 6,
        }
    }
}

/// What the robot is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guidance {
    /// How it goes.
    pub status: NavigationStatus,
    /// The image that it steers to; `None` before it has ever known where it is.
    pub subgoal: Option<ImageId>,
    /// Where to drive, from straight ahead to the left, in (-π, π]; `None` if nothing has shown
    /// that, or there is nowhere left to go.
    pub heading_rad: Option<f64>,
    /// Sum of 1 / S from the subgoal to the goal.
    pub remaining: Option<f64>,
    /// Images of the map that the observation was compared with.
    pub compared: usize,
}

/// How a navigation goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NavigationStatus {
    /// The subgoal is in sight.
    Driving,
    /// It is not; the robot keeps its heading.
    Recovering,
    /// Nothing in the map that leads to the goal looks like what is seen.
    Lost,
    /// Something holds the robot.
    Blocked,
    /// The goal is reached.
    Arrived,
}

/// Takes one robot to one goal.
#[derive(Clone, Debug)]
pub struct AppearanceNavigator {
    settings: NavigationSettings,
    distances: GoalDistances,
    /// Similarity with the goal at which it is reached.
    arrival_similarity: f64,
    subgoal: Option<ImageId>,
    heading: SmoothedHeading,
    /// Observations in a row that gave no heading.
    misses: u32,
    /// Largest similarity with the subgoal since it became one, and observations in a row since.
    best_seen: f64,
    stalled: u32,
}

/// What one observation has been compared with so far.
struct Compared<'a, S> {
    sight: &'a S,
    overlaps: BTreeMap<ImageId, Option<Overlap>>,
}

impl<S: Sight> Compared<'_, S> {
    fn overlap(&mut self, image: ImageId) -> Option<Overlap> {
        *self.overlaps.entry(image).or_insert_with(|| self.sight.overlap(image))
    }
}

impl AppearanceNavigator {
    /// On the way to `goal`.
    ///
    /// # Errors
    /// [`NoSuchImage`] if the graph does not have it.
    pub fn new(
        graph: &AppearanceGraph,
        goal: ImageId,
        settings: NavigationSettings,
    ) -> Result<Self, NoSuchImage> {
        let distances = graph.distances_to(goal)?;
        let best = graph.neighbours(goal).iter().map(|link| link.similarity).fold(0.0, f64::max);
        Ok(Self {
            arrival_similarity: (settings.arrival_share * best).max(LINK_SIMILARITY),
            settings,
            distances,
            subgoal: None,
            heading: SmoothedHeading::new(settings.recency),
            misses: 0,
            best_seen: 0.0,
            stalled: 0,
        })
    }

    /// Takes what the robot sees, and says where to drive.
    pub fn observe<S: Sight>(&mut self, graph: &AppearanceGraph, sight: &S, body: Body) -> Guidance {
        let mut compared = Compared { sight, overlaps: BTreeMap::new() };
        let mut subgoal = match self.subgoal {
            Some(subgoal) if !self.is_out_of_patience() => Some(subgoal),
            Some(_) | None => self.relocalized(&mut compared),
        };
        if let Some(image) = subgoal {
            subgoal = Some(self.advanced(graph, image, &mut compared));
        }
        let overlap = subgoal.and_then(|image| compared.overlap(image)).filter(matches);
        self.heading.turn(sight.turned_rad().unwrap_or(0.0));
        if let Some(overlap) = &overlap {
            self.heading.take(overlap.motion.heading_rad());
        }
        let was_lost = subgoal.is_none();
        self.misses = if overlap.is_some() { 0 } else { (self.misses + 1).min(self.settings.patience) };
        self.note_progress(subgoal, overlap.map_or(0.0, |overlap| overlap.similarity()));
        self.subgoal = subgoal.or(self.subgoal);
        let status = if overlap.is_some_and(|overlap| self.has_arrived(&overlap)) {
            NavigationStatus::Arrived
        } else if was_lost {
            NavigationStatus::Lost
        } else if body == Body::Held {
            NavigationStatus::Blocked
        } else if overlap.is_some() {
            NavigationStatus::Driving
        } else {
            NavigationStatus::Recovering
        };
        Guidance {
            status,
            subgoal: self.subgoal,
            heading_rad: self.heading.heading_rad().filter(|_| status != NavigationStatus::Arrived),
            remaining: self.subgoal.and_then(|subgoal| self.distances.of(subgoal)),
            compared: compared.overlaps.len(),
        }
    }

    /// How far images are from the goal.
    #[must_use]
    pub fn distances(&self) -> &GoalDistances {
        &self.distances
    }

    /// Whether the subgoal has not been seen for long, or not better than before for longer: what
    /// is in the way may have to be gone around, or it was the wrong one.
    fn is_out_of_patience(&self) -> bool {
        self.misses >= self.settings.patience || self.stalled >= self.settings.stall_patience
    }

    fn note_progress(&mut self, subgoal: Option<ImageId>, similarity: f64) {
        let begins_anew = subgoal != self.subgoal || self.is_out_of_patience();
        if begins_anew || similarity > self.best_seen {
            (self.best_seen, self.stalled) = (similarity, 0);
        } else {
            self.stalled += 1;
        }
    }

    /// Of the images that lead to the goal, the one most similar to what is seen.
    fn relocalized<S: Sight>(&self, compared: &mut Compared<'_, S>) -> Option<ImageId> {
        let mut best: Option<(f64, ImageId)> = None;
        for image in compared.sight.relocalization_candidates() {
            if self.distances.of(image).is_none() {
                continue;
            }
            let found = compared.overlap(image).filter(matches);
            let similarity = found.map_or(0.0, |overlap| overlap.similarity());
            if similarity > best.map_or(0.0, |(most, _)| most) {
                best = Some((similarity, image));
            }
        }
        best.map(|(_, image)| image)
    }

    /// As far from a subgoal towards the goal as neighbours match.
    fn advanced<S: Sight>(
        &self,
        graph: &AppearanceGraph,
        mut subgoal: ImageId,
        compared: &mut Compared<'_, S>,
    ) -> ImageId {
        let mut left = self.settings.max_neighbours;
        'subgoals: loop {
            let here = self.distances.of(subgoal).unwrap_or(f64::INFINITY);
            let next = self.distances.next(graph, subgoal).map_or(0.0, |link| link.similarity);
            let wanted =
                if self.is_at(graph, subgoal, compared) { 0.0 } else { self.settings.advance_share * next };
            let is_well_seen = |overlap: Overlap| matches(&overlap) && overlap.similarity() >= wanted;
            let is_nearer = |link: &&Link| self.distances.of(link.to).is_some_and(|there| there < here);
            let mut nearer: Vec<&Link> = graph.neighbours(subgoal).iter().filter(is_nearer).collect();
            nearer.sort_by(|a, b| b.similarity.total_cmp(&a.similarity).then(a.to.cmp(&b.to)));
            for link in nearer {
                if !compared.overlaps.contains_key(&link.to) {
                    if left == 0 {
                        continue;
                    }
                    left -= 1;
                }
                if compared.overlap(link.to).is_some_and(is_well_seen) {
                    subgoal = link.to;
                    continue 'subgoals;
                }
            }
            return subgoal;
        }
    }

    /// Whether the robot sees an image better than any other of the map does: it can come no nearer
    /// by what it sees.
    fn is_at<S: Sight>(
        &self,
        graph: &AppearanceGraph,
        image: ImageId,
        compared: &mut Compared<'_, S>,
    ) -> bool {
        let best = graph.neighbours(image).iter().map(|link| link.similarity).fold(0.0, f64::max);
        compared.overlap(image).is_some_and(|overlap| overlap.similarity() >= best)
    }

    fn has_arrived(&self, overlap: &Overlap) -> bool {
        self.subgoal == Some(self.distances.goal()) && overlap.similarity() >= self.arrival_similarity
    }
}

/// Whether an image is like what is seen, as linked images are like each other.
fn matches(overlap: &Overlap) -> bool {
    overlap.similarity() > LINK_SIMILARITY
}

#[cfg(test)]
mod tests;
