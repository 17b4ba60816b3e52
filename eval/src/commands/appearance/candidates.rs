//! Links between places that look alike.

use anyhow::Result;
use serde::Serialize;
use waypost_sim::worlds::NamedWorld;

use super::eye::{Eye, TaughtMap};

/// Two images that are further apart share no room, or too little to be told.
const FAR_M: f64 = 6.0;

/// Links of a building whose offices look alike.
#[derive(Serialize)]
pub(crate) struct LookAlikeFigures {
    /// Panoramas.
    pub panoramas: usize,
    /// Links, each compared with each.
    pub links: usize,
    /// Links between images that are further apart than 6 m.
    pub links_far_apart: usize,
    /// Pairs that are further apart.
    pub pairs_far_apart: usize,
    /// The largest similarity of a pair that is further apart.
    pub similarity_far_apart_max: f64,
}

/// Compares all images of a building with offices that differ in a fifth of their texture.
pub(crate) fn look_alikes(eye: &Eye, seed: u64) -> Result<LookAlikeFigures> {
    let map = TaughtMap::new(eye, NamedWorld::Corridors.plan(seed), 1.2, seed)?;
    let is_far = |a: usize, b: usize| map.poses[a].distance_m(&map.poses[b]) > FAR_M;
    let far: Vec<f64> = map
        .graph
        .links()
        .filter(|(from, link)| is_far(*from as usize, link.to as usize))
        .map(|(_, link)| link.similarity)
        .collect();
    let count = map.poses.len();
    Ok(LookAlikeFigures {
        panoramas: count,
        links: map.graph.links().count(),
        links_far_apart: far.len(),
        pairs_far_apart: (0..count).map(|a| (0..a).filter(|&b| is_far(a, b)).count()).sum(),
        similarity_far_apart_max: far.into_iter().fold(0.0, f64::max),
    })
}
