//! Whether a label that is put on all of a room stays in it.

use anyhow::Result;
use rayon::prelude::*;
use serde::Serialize;
use waypost_navigation::appearance::graph::ImageId;
use waypost_sim::worlds::NamedWorld;

use super::eye::{Eye, TaughtMap};
use super::trials::SPACING_M;

/// Rooms with fewer images than this are closets.
const LEAST_IMAGES: usize = 4;

/// Labels of all rooms of some buildings, put at each of their images in turn.
#[derive(Serialize)]
pub(crate) struct RoomFigures {
    /// Labels that were put.
    pub labels: usize,
    /// As labels are put.
    pub around: SpillFigures,
    /// On whole convex spaces.
    pub spaces: SpillFigures,
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

/// Puts labels in buildings of these seeds.
pub(crate) fn measure(eye: &Eye, seeds: &[u64]) -> Result<RoomFigures> {
    let buildings: Result<Vec<Vec<[Put; 2]>>> = seeds.par_iter().map(|&seed| labels(eye, seed)).collect();
    let labels: Vec<[Put; 2]> = buildings?.into_iter().flatten().collect();
    let figures = |rule: usize| {
        let put = || labels.iter().map(move |by_rule| &by_rule[rule]);
        let count = labels.len().max(1) as f64;
        SpillFigures {
            spilled_mean: put().map(|label| label.spilled as f64).sum::<f64>() / count,
            spilled_max: put().map(|label| label.spilled).max().unwrap_or(0),
            clean: put().filter(|label| label.spilled == 0).count(),
            covered_mean: put().map(|label| label.covered).sum::<f64>() / count,
        }
    };
    Ok(RoomFigures { labels: labels.len(), around: figures(0), spaces: figures(1) })
}

/// By image of a room: around it, and on its space.
fn labels(eye: &Eye, seed: u64) -> Result<Vec<[Put; 2]>> {
    let map = TaughtMap::new(eye, NamedWorld::BooijOffice.plan(seed), SPACING_M, seed)?;
    let plan = map.scene.plan();
    let rooms: Vec<&str> = map
        .poses
        .iter()
        .map(|pose| plan.room_at(pose.position()).map_or("", |room| room.name.as_str()))
        .collect();
    let spaces = map.graph.convex_spaces();
    let size = |room: &str| rooms.iter().filter(|other| **other == room).count();
    let labelled = |image: usize| {
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
    // A hall is no room: people name what has a door.
    let is_named = |image: &usize| {
        let room = rooms[*image];
        !room.is_empty() && !room.contains("hall") && size(room) >= LEAST_IMAGES
    };
    Ok((0..rooms.len()).filter(is_named).map(labelled).collect())
}
