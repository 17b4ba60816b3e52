//! The way to one goal, panorama by panorama.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;

use crate::ingest::PanoramicView;
use waypost_navigation::appearance::epipolar::SearchSettings;
use waypost_navigation::appearance::graph::{ImageId, LINK_SIMILARITY, Overlap, Panorama};
use waypost_navigation::appearance::navigator::{
    AppearanceNavigator, Body, Guidance, NavigationSettings, NavigationStatus, Sight,
};
use waypost_navigation::metric::Status;

use super::goals::{self, Unjoined};
use crate::error::ServiceError;
use crate::open_map::appearance::{Graph, Shown};
use crate::service::navigation::Goal;

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
    /// By image: whether links lead from it to any of them.
    leading: Arc<[bool]>,
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
    /// Why it is not led, if that is because nothing joins the goal with where it is.
    pub(super) unjoined: Option<Unjoined>,
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

    /// Of the images that `is_wanted`, the one that looks most like what is seen, and enough so.
    fn most_similar(&self, is_wanted: impl Fn(ImageId) -> bool) -> Option<ImageId> {
        let named = self.graph.candidates(self.seen).into_iter().filter(|&image| is_wanted(image));
        let similar = named.map(|image| (self.similarity(image), image));
        let similar = similar.filter(|(similarity, _)| *similarity > LINK_SIMILARITY);
        similar.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))).map(|(_, image)| image)
    }
}

impl Panorama for Sighting<'_> {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        self.compared(image)
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
    Sighting::new(graph, seen, None).most_similar(|_| true)
}

impl Journey {
    /// To the middle of the nearest `goals`; there is one at least.
    pub(super) fn new(number: u64, asked: Goal, graph: Arc<Graph>, goals: Vec<ImageId>) -> Self {
        let leading = goals::leading(graph.appearance(), &goals).into();
        Self { number, asked, graph, has_arrived: false, goals, leading, navigator: None }
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
        let Some(goal) = self.goal().or_else(|| self.nearest_goal(&sighting)) else {
            return Ok(self.not_led(&sighting));
        };
        let mut navigator = match self.navigator.take() {
            Some(navigator) => navigator,
            None => AppearanceNavigator::new(graph.appearance(), goal, NavigationSettings::default())
                .map_err(ServiceError::internal)?,
        };
        let guidance = navigator.observe(graph.appearance(), &sighting, body);
        self.navigator = Some(navigator);
        let Guidance { status, subgoal, heading_rad, remaining, compared: _ } = guidance;
        if status == NavigationStatus::Lost {
            return Ok(self.not_led(&sighting));
        }
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
            unjoined: None,
        })
    }

    /// The goal that is meant; none while the robot sees nothing from which a way leads to any.
    fn nearest_goal(&self, sighting: &Sighting<'_>) -> Option<ImageId> {
        let here = sighting.most_similar(|image| self.leads(image))?;
        goals::nearest(self.graph.appearance(), &self.goals, here)
    }

    fn leads(&self, image: ImageId) -> bool {
        self.leading.get(image as usize).copied().unwrap_or(false)
    }

    /// For a robot that sees nothing from which a way leads to the goal: it stands if it knows all the same where it is, and
    /// looks around otherwise.
    fn not_led(&self, sighting: &Sighting<'_>) -> Step {
        let here = sighting.most_similar(|image| !self.leads(image));
        let unjoined = here.and_then(|here| {
            let place = |image| self.graph.place_of(image);
            Some(Unjoined {
                from: place(here)?,
                goal: place(*self.goals.first()?)?,
                others: self.goals.len() - 1,
            })
        });
        let status = if unjoined.is_some() { Status::Blocked } else { Status::Lost };
        Step { status, heading_rad: None, subgoal: None, similarity: None, left: None, unjoined }
    }
}
