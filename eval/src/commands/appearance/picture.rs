//! The graph over the plan, and the drives over the graph.

use nalgebra::Vector2;
use waypost_sim::drawing::{Layer, Marks, plan_svg};
use waypost_sim::pose::Pose;

use super::eye::TaughtMap;
use super::trials::Drive;

/// Colours of the drives, in turn.
const COLOURS: [&str; 6] = ["#1459aa", "#d01020", "#208050", "#e0a040", "#803090", "#207890"];

/// One file of SVG: links as dark as their images are similar, then where the robot drove.
pub(crate) fn svg(map: &TaughtMap, drives: &[Drive]) -> String {
    let at: Vec<Vector2<f64>> = map.poses.iter().map(Pose::position).collect();
    let mut links: Vec<_> = map
        .graph
        .links()
        .map(|(from, link)| (at[from as usize], at[link.to as usize], link.similarity.min(1.0)))
        .collect();
    links.sort_by(|a, b| a.2.total_cmp(&b.2));
    let graph =
        Layer { name: "links, by similarity".into(), colour: "#000".into(), marks: Marks::Links(links) };
    let driven = drives.iter().zip(COLOURS.iter().cycle()).map(|(drive, colour)| {
        let people = match drive.people {
            0 => String::new(),
            1 => ", 1 person in the way".to_owned(),
            many => format!(", {many} people in the way"),
        };
        let name = format!("{}{people}: {:.1} m", drive.route, drive.driven_m);
        Layer { name, colour: (*colour).to_owned(), marks: Marks::Path(drive.path.clone()) }
    });
    let layers: Vec<Layer> = std::iter::once(graph).chain(driven).collect();
    plan_svg(map.scene.plan(), &layers)
}
