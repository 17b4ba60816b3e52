//! Goals of an appearance graph: which images they are, whether any way leads there, and which of several is meant.

use std::collections::BTreeSet;
use std::fmt::{self, Display};

use fabmap::appearance::PlaceId;
use waypost_navigation::appearance::graph::{AppearanceGraph, ImageId};

use crate::error::ServiceError;
use crate::open_map::appearance::Graph;
use crate::service::navigation::WayByLooks;

/// A goal that no links lead to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Unjoined {
    /// The place to start from.
    pub(crate) from: PlaceId,
    /// The goal, or the first of several.
    pub(crate) goal: PlaceId,
    /// How many more there are.
    pub(crate) others: usize,
}

impl Unjoined {
    /// The reason, and how to mend it, for the operator of the robot.
    pub(crate) fn of_the_robot(&self) -> String {
        format!(
            "no links lead from where the robot is (place {}) to the goal ({}): map a drive that joins them, and set the \
             goal again",
            self.from,
            self.goals()
        )
    }

    /// The same for a caller that plans a way from a place.
    pub(super) fn of_the_way(&self) -> String {
        format!(
            "no links lead from the place {} to the goal ({}): map a drive that joins them",
            self.from,
            self.goals()
        )
    }

    fn goals(&self) -> impl Display {
        fmt::from_fn(|f| match self.others {
            0 => write!(f, "place {}", self.goal),
            1 => write!(f, "place {} and another one", self.goal),
            others => write!(f, "place {} and {others} others", self.goal),
        })
    }
}

impl WayByLooks {
    /// The shortest way from an image to the nearest of `goals`, one at least.
    pub(super) fn plan(graph: &Graph, here: ImageId, goals: &[ImageId]) -> Result<Self, ServiceError> {
        let links = graph.appearance();
        let place = |image| {
            graph.place_of(image).ok_or_else(|| ServiceError::internal("an image of the graph has no place"))
        };
        let Some(goal) = nearest(links, goals, here) else {
            let unjoined = Unjoined { from: place(here)?, goal: place(goals[0])?, others: goals.len() - 1 };
            return Err(ServiceError::precondition(unjoined.of_the_way()));
        };
        let distances = links.distances_to(goal).map_err(ServiceError::internal)?;
        let places: Result<_, ServiceError> = distances.path(links, here).into_iter().map(place).collect();
        Ok(Self { places: places?, length: distances.of(here).unwrap_or(0.0) })
    }
}

/// The images of places that a way may lead to; there is one at least.
pub(super) fn images(map: &str, graph: &Graph, places: &[PlaceId]) -> Result<Vec<ImageId>, ServiceError> {
    let named = |places: &[PlaceId]| places.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
    let images: Vec<ImageId> = places.iter().filter_map(|&place| graph.image_of(place)).collect();
    if images.is_empty() {
        return Err(ServiceError::not_found(format_args!(
            "the place {} is no node of the map {map}'s appearance graph: there is no such place, or no panorama made it; \
             get the graph to see which there are",
            named(places)
        )));
    }
    let is_linked = |image: &ImageId| !graph.appearance().neighbours(*image).is_empty();
    let linked: Vec<ImageId> = images.iter().copied().filter(is_linked).collect();
    if linked.is_empty() && graph.places().len() > 1 {
        return Err(ServiceError::precondition(format_args!(
            "the place {} of the map {map} looks like no other place, so no way leads there; teach the way to it",
            named(places)
        )));
    }
    Ok(if linked.is_empty() { images } else { linked })
}

/// Of several goals the nearest by the shortest path, or rather the middle of those that hang together with it: one who
/// goes to a room goes into it. None if no path leads to any.
pub(super) fn nearest(graph: &AppearanceGraph, goals: &[ImageId], here: ImageId) -> Option<ImageId> {
    let distances = graph.distances_to(here).ok()?;
    let reached = goals.iter().filter_map(|&goal| Some((distances.of(goal)?, goal)));
    let nearest = reached.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    nearest.map(|(_, goal)| middle(graph, &joined(graph, goals, goal)))
}

/// By image: whether links lead from it to one of `goals`.
pub(super) fn leading(graph: &AppearanceGraph, goals: &[ImageId]) -> Vec<bool> {
    let mut leads = vec![false; graph.len()];
    let mut next = goals.to_vec();
    while let Some(image) = next.pop() {
        if let Some(leads) = leads.get_mut(image as usize).filter(|leads| !**leads) {
            *leads = true;
            next.extend(graph.neighbours(image).iter().map(|link| link.to));
        }
    }
    leads
}

/// Those of `images` that links among them join with one of them.
fn joined(graph: &AppearanceGraph, images: &[ImageId], one: ImageId) -> Vec<ImageId> {
    let mut found = BTreeSet::from([one]);
    let mut next = vec![one];
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

    /// A chain of seven and two beside it.
    fn chain() -> AppearanceGraph {
        let mut graph = AppearanceGraph::default();
        for _ in 0..9 {
            graph.add_image();
        }
        (0..6).for_each(|image| graph.link(image, image + 1, 0.5));
        graph.link(7, 8, 0.5);
        graph
    }

    #[test]
    fn the_middle_of_what_hangs_together_is_found() {
        let graph = chain();
        let joined = |images: &[ImageId], one| super::joined(&graph, images, one);
        assert_eq!(joined(&[2, 3, 4, 6, 7], 2), [2, 3, 4]);
        assert_eq!(joined(&[2, 3, 4, 6, 7], 6), [6]);
        assert_eq!(middle(&graph, &[2, 3, 4]), 3);
        assert_eq!(middle(&graph, &[0, 1, 2, 3, 4]), 2);
        assert_eq!(middle(&graph, &[7]), 7);
    }

    #[test]
    fn of_several_goals_one_is_taken_that_can_be_reached() {
        let graph = chain();
        assert_eq!(nearest(&graph, &[2, 3, 4, 7, 8], 0), Some(3));
        assert_eq!(nearest(&graph, &[6, 8], 7), Some(8));
        assert_eq!(nearest(&graph, &[6], 7), None);
        assert_eq!(leading(&graph, &[6]), [[true; 7].as_slice(), &[false; 2]].concat());
        assert_eq!(leading(&graph, &[8]), [[false; 7].as_slice(), &[true; 2]].concat());
        assert_eq!(leading(&graph, &[0, 7]), [true; 9]);
    }

    #[test]
    fn what_is_missing_is_said() {
        let unjoined = Unjoined { from: 12, goal: 40, others: 0 };
        let message = unjoined.of_the_robot();
        assert!(
            message.starts_with(
                "no links lead from where the robot is (place 12) to the goal (place 40): map a drive that joins them"
            ),
            "{message}"
        );
        let several = Unjoined { others: 3, ..unjoined }.of_the_way();
        assert!(several.contains("from the place 12 to the goal (place 40 and 3 others): map"), "{several}");
    }
}
