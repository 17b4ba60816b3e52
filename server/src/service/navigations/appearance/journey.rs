//! The way to one goal, panorama by panorama.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use topomap::appearance_graph::{AppearanceGraph, ImageId, LINK_SIMILARITY, Overlap, Panorama};
use topomap::appearance_navigation::{
    AppearanceNavigator, Body, Guidance, NavigationSettings, NavigationStatus, Sight,
};
use topomap::epipolar::SearchSettings;
use topomap::mapper::{ArchiveError, FrameError};
use topomap::navigation::Status;
use waypost_vision::panorama::PanoramicView;

use crate::error::ServiceError;
use crate::service::appearance::{Graph, Shown};
use crate::service::navigations::Goal;

/// On the way to a goal, over the graph as it was when that was asked for.
#[derive(Clone, Debug)]
pub(super) struct Journey {
    /// Of the goal, as they were asked for.
    pub(super) number: u64,
    pub(super) asked: Goal,
    pub(super) graph: Arc<Graph>,
    pub(super) has_arrived: bool,
    /// Where it may end: in the middle of the nearest ones, once it is known where the robot is.
    goals: Vec<ImageId>,
    navigator: Option<AppearanceNavigator>,
}

/// What came of one panorama.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) status: Status,
    /// In the camera's frame.
    pub(super) heading_rad: Option<f64>,
    pub(super) subgoal: Option<ImageId>,
    /// Of what is seen with the subgoal.
    pub(super) similarity: Option<f64>,
    pub(super) left: Option<f64>,
}

/// What the robot sees, and all that it has been compared with so far.
struct Sighting<'a> {
    graph: &'a Graph,
    seen: &'a Shown,
    before: Option<&'a PanoramicView>,
    overlaps: RefCell<BTreeMap<ImageId, Option<Overlap>>>,
}

impl<'a> Sighting<'a> {
    fn new(graph: &'a Graph, seen: &'a Shown, before: Option<&'a PanoramicView>) -> Self {
        Self { graph, seen, before, overlaps: RefCell::default() }
    }

    fn compared(&self, image: ImageId) -> Option<Overlap> {
        let known = self.overlaps.borrow().get(&image).copied();
        known.unwrap_or_else(|| {
            let overlap = self.graph.compare(&self.seen.view, image);
            self.overlaps.borrow_mut().insert(image, overlap);
            overlap
        })
    }

    fn similarity(&self, image: ImageId) -> f64 {
        self.compared(image).map_or(0.0, |overlap| overlap.similarity())
    }

    /// The image that looks most like what is seen, and enough so.
    fn most_similar(&self) -> Option<ImageId> {
        let named = self.graph.candidates(self.seen).into_iter();
        let similar = named.map(|image| (self.similarity(image), image));
        let similar = similar.filter(|(similarity, _)| *similarity > LINK_SIMILARITY);
        similar.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))).map(|(_, image)| image)
    }
}

impl Panorama for Sighting<'_> {
    fn overlap(&self, image: ImageId) -> Result<Option<Overlap>, ArchiveError> {
        Ok(self.compared(image))
    }
}

impl Sight for Sighting<'_> {
    fn turned_rad(&self) -> Option<f64> {
        let overlap = self.seen.view.compare(self.before?, &SearchSettings::default()).overlap?;
        // The one before looked further to the left by R if the robot has turned right by it.
        Some(-overlap.motion.rotation_rad())
    }

    fn relocalization_candidates(&self) -> Vec<ImageId> {
        self.graph.candidates(self.seen)
    }
}

/// The image of a graph that looks most like a panorama; none if none does enough.
pub(super) fn most_similar(graph: &Graph, seen: &Shown) -> Option<ImageId> {
    Sighting::new(graph, seen, None).most_similar()
}

impl Journey {
    /// To the middle of the nearest `goals`; there is one at least.
    pub(super) fn new(number: u64, asked: Goal, graph: Arc<Graph>, goals: Vec<ImageId>) -> Self {
        Self { number, asked, graph, has_arrived: false, goals, navigator: None }
    }

    /// Where it ends, if that is known.
    pub(super) fn goal(&self) -> Option<ImageId> {
        match (&self.navigator, self.goals.as_slice()) {
            (Some(navigator), _) => Some(navigator.distances().goal()),
            (None, [goal]) => Some(*goal),
            (None, _) => None,
        }
    }

    /// Takes a panorama, after the one `before`.
    pub(super) fn step(
        &mut self,
        seen: &Shown,
        before: Option<&PanoramicView>,
        body: Body,
    ) -> Result<Step, ServiceError> {
        let graph = self.graph.clone();
        let sighting = Sighting::new(&graph, seen, before);
        let goal = self.goal().or_else(|| self.nearest_goal(&sighting));
        let Some(goal) = goal else {
            return Ok(Step {
                status: Status::Lost,
                heading_rad: None,
                subgoal: None,
                similarity: None,
                left: None,
            });
        };
        let mut navigator = match self.navigator.take() {
            Some(navigator) => navigator,
            None => AppearanceNavigator::new(graph.appearance(), goal, NavigationSettings::default())
                .map_err(ServiceError::internal)?,
        };
        let guidance = navigator.observe(graph.appearance(), &sighting, body).map_err(FrameError::from)?;
        self.navigator = Some(navigator);
        let Guidance { status, subgoal, heading_rad, remaining, compared: _ } = guidance;
        self.has_arrived = status == NavigationStatus::Arrived;
        let similarity = subgoal.and_then(|subgoal| sighting.compared(subgoal));
        Ok(Step {
            status: match status {
                NavigationStatus::Driving => Status::Following,
                NavigationStatus::Recovering => Status::Searching,
                NavigationStatus::Lost => Status::Lost,
                NavigationStatus::Blocked => Status::Blocked,
                NavigationStatus::Arrived => Status::Arrived,
            },
            heading_rad,
            subgoal,
            similarity: similarity.map(|overlap| overlap.similarity()),
            left: remaining,
        })
    }

    /// Of several goals the nearest by the shortest path, or rather the middle of those that hang together with it: whoever
    /// goes to a room goes into it. None while it is not known where the robot is, or no path leads to any.
    fn nearest_goal(&self, sighting: &Sighting<'_>) -> Option<ImageId> {
        let here = sighting.most_similar()?;
        let distances = self.graph.appearance().distances_to(here).ok()?;
        let reached = self.goals.iter().filter_map(|&goal| Some((distances.of(goal)?, goal)));
        let nearest = reached.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.map(|(_, goal)| {
            middle(self.graph.appearance(), &joined(self.graph.appearance(), &self.goals, goal))
        })
    }
}

/// Those of `images` that links among them join with one of them.
fn joined(graph: &AppearanceGraph, images: &[ImageId], one: ImageId) -> Vec<ImageId> {
    let (mut found, mut next) = (BTreeSet::from([one]), vec![one]);
    while let Some(image) = next.pop() {
        for link in graph.neighbours(image) {
            if images.contains(&link.to) && found.insert(link.to) {
                next.push(link.to);
            }
        }
    }
    found.into_iter().collect()
}

/// That of some images, one at least, from which the paths to the others are shortest in all.
fn middle(graph: &AppearanceGraph, images: &[ImageId]) -> ImageId {
    let total = |&from: &ImageId| {
        let distances = graph.distances_to(from).ok();
        let paths = images.iter().map(|&to| distances.as_ref().and_then(|paths| paths.of(to)));
        paths.map(|path| path.unwrap_or(f64::INFINITY)).sum::<f64>()
    };
    let totals = images.iter().map(|image| (total(image), *image));
    let least = totals.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    least.map_or_else(|| images[0], |(_, image)| image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_what_hangs_together_is_found() {
        // A chain of seven and one beside it.
        let mut graph = AppearanceGraph::default();
        for _ in 0..8 {
            graph.add_image();
        }
        (0..6).for_each(|image| graph.link(image, image + 1, 0.5));
        let joined = |images: &[ImageId], one| super::joined(&graph, images, one);
        assert_eq!(joined(&[2, 3, 4, 6, 7], 2), [2, 3, 4]);
        assert_eq!(joined(&[2, 3, 4, 6, 7], 6), [6]);
        assert_eq!(middle(&graph, &[2, 3, 4]), 3);
        assert_eq!(middle(&graph, &[0, 1, 2, 3, 4]), 2);
        assert_eq!(middle(&graph, &[7]), 7);
    }
}
