//! Whether a label that is put on all of a room stays in it.

use anyhow::Result;
use rayon::prelude::*;
use serde::Serialize;
use waypost_navigation::appearance::graph::ImageId;
use waypost_sim::pose::Pose;
use waypost_sim::worlds::{NamedRoute, NamedWorld};

use super::eye::{Eye, TaughtMap};
use super::trials::SPACING_M;

/// Rooms with fewer images than this are closets.
const LEAST_IMAGES: usize = 4;

/// Labels of all rooms, or all halls, of some buildings, put at each of their images in turn.
#[derive(Serialize)]
pub(crate) struct RoomFigures {
    /// Kind of building.
    pub world: &'static str,
    /// Where its images were taken.
    pub images: Images,
    /// What was labelled.
    pub labelled: Labelled,
    /// Labels that were put.
    pub labels: usize,
    /// What bears the label.
    pub on: Rule,
    #[serde(flatten)]
    pub spilled: SpillFigures,
}

/// Where the images of a map were taken.
#[derive(Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Images {
    /// All over the building.
    Scattered,
    /// Along the ways that a robot was driven, as maps are made.
    Driven,
}

/// What a label is put on.
#[derive(Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Labelled {
    /// What lies behind a door.
    Rooms,
    /// What rooms open onto.
    Halls,
}

/// What bears a label that was put at an image.
#[derive(Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Rule {
    /// Its room, as servers put labels.
    Room,
    /// Its whole convex space.
    Space,
}

/// Which images bear labels that were put by one rule.
#[derive(Serialize)]
pub(crate) struct SpillFigures {
    /// Images that bear a label of another room, mean over the labels.
    pub spilled_mean: f64,
    /// The most that any label spilled.
    pub spilled_max: usize,
    /// Labels that no image of another room bears.
    pub clean: usize,
    /// Share of the room's images that bear its label, mean over the labels.
    pub covered_mean: f64,
}

/// One label by one rule.
struct Put {
    spilled: usize,
    covered: f64,
}

/// Buildings in which labels are put: rooms along narrow halls, rooms off a wide one, and two off a short one.
const WORLDS: [NamedWorld; 3] = [NamedWorld::BooijOffice, NamedWorld::Gallery, NamedWorld::Foyer];

/// Puts labels in buildings of these seeds.
pub(crate) fn measure(eye: &Eye, seeds: &[u64]) -> Result<Vec<RoomFigures>> {
    let mut figures = Vec::new();
    for world in WORLDS {
        for images in [Images::Scattered, Images::Driven] {
            let maps = seeds.par_iter().map(|&seed| images.of(eye, world, seed));
            let maps: Vec<TaughtMap> = maps.collect::<Result<_>>()?;
            for labelled in [Labelled::Rooms, Labelled::Halls] {
                let put: Vec<[Put; 2]> = maps.par_iter().flat_map(|map| labels(map, labelled)).collect();
                for (by_rule, on) in [Rule::Room, Rule::Space].into_iter().enumerate() {
                    let spilled = SpillFigures::of(&put, by_rule);
                    let world = world.name();
                    figures.push(RoomFigures { world, images, labelled, labels: put.len(), on, spilled });
                }
            }
        }
    }
    Ok(figures)
}

impl Images {
    fn of(self, eye: &Eye, world: NamedWorld, seed: u64) -> Result<TaughtMap> {
        match self {
            Self::Scattered => TaughtMap::new(eye, world.plan(seed), SPACING_M, seed),
            Self::Driven => TaughtMap::at(eye, world.plan(seed), along(&world.routes()), seed),
        }
    }
}

/// Poses along routes, looking ahead; where a robot comes by again it recognises the place, and adds no image.
fn along(routes: &[NamedRoute]) -> Vec<Pose> {
    let mut poses: Vec<Pose> = Vec::new();
    for corners in routes.iter().flat_map(|route| route.corners.windows(2)) {
        let way = corners[1] - corners[0];
        let steps = (way.norm() / SPACING_M).round().max(1.0);
        for step in 0..=steps as u32 {
            let point = corners[0] + way * (f64::from(step) / steps);
            if poses.iter().all(|pose| (pose.position() - point).norm() > SPACING_M / 2.0) {
                poses.push(Pose::new(point.x, point.y, way.y.atan2(way.x)));
            }
        }
    }
    poses
}

impl SpillFigures {
    fn of(labels: &[[Put; 2]], rule: usize) -> Self {
        let put = || labels.iter().map(|by_rule| &by_rule[rule]);
        let count = labels.len().max(1) as f64;
        Self {
            spilled_mean: put().map(|label| label.spilled as f64).sum::<f64>() / count,
            spilled_max: put().map(|label| label.spilled).max().unwrap_or(0),
            clean: put().filter(|label| label.spilled == 0).count(),
            covered_mean: put().map(|label| label.covered).sum::<f64>() / count,
        }
    }
}

/// By image of what is labelled: around it, and on its space.
fn labels(map: &TaughtMap, labelled: Labelled) -> Vec<[Put; 2]> {
    let plan = map.scene.plan();
    let rooms: Vec<&str> = map
        .poses
        .iter()
        .map(|pose| plan.room_at(pose.position()).map_or("", |room| room.name.as_str()))
        .collect();
    let spaces = map.graph.convex_spaces();
    let size = |room: &str| rooms.iter().filter(|other| **other == room).count();
    let put_at = |image: usize| {
        let room = rooms[image];
        let inside = |images: &[ImageId]| images.iter().filter(|&&one| rooms[one as usize] == room).count();
        let around = map.graph.room_around(image as ImageId, &spaces);
        let space: Vec<ImageId> =
            (0..).zip(&spaces).filter(|(_, space)| **space == spaces[image]).map(|(one, _)| one).collect();
        [around, space].map(|images| {
            let inside = inside(&images);
            Put { spilled: images.len() - inside, covered: inside as f64 / size(room) as f64 }
        })
    };
    let is_labelled = |image: &usize| {
        let room = rooms[*image];
        let is_hall = room.contains("hall");
        !room.is_empty() && is_hall == (labelled == Labelled::Halls) && size(room) >= LEAST_IMAGES
    };
    (0..rooms.len()).filter(is_labelled).map(put_at).collect()
}
