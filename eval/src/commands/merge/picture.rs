//! Maps before and after, as in the overview paper's figure 5: trajectories blue, links within a session red, links
//! between sessions green.

use fabmap::PlaceId;
use nalgebra::Vector2;
use posegraph::{PlanarPose, Pose};
use topomap::ids::SessionId;
use waypost_sim::drawing::{Layer, Marks, plan_svg};
use waypost_sim::scene::Scene;

use super::world::TrueMap;
use crate::commands::map::alignment::{Alignment, aligned, position};

const TRAJECTORY: &str = "#1459aa";
const WITHIN: &str = "#d01020";
const BETWEEN: &str = "#208050";

/// Each map where its own first pose truly was, beside the others.
pub(super) fn inputs(scene: &Scene, maps: &[TrueMap]) -> String {
    let layers: Vec<Layer> = maps
        .iter()
        .enumerate()
        .flat_map(|(number, map)| {
            let first =
                map.frames.iter().flatten().next().map_or_else(PlanarPose::identity, |frame| frame.pose);
            let at = |pose: &PlanarPose| position(&first.compose(pose));
            let name = |what: &str| if number == 0 { what.to_owned() } else { String::new() };
            drawn(map, &at, name)
        })
        .collect();
    plan_svg(scene.plan(), &layers)
}

/// The merged map, laid over the truth.
pub(super) fn merged(scene: &Scene, map: &TrueMap) -> String {
    let (poses, truth) = map.trajectory();
    let laid = aligned(&poses, &truth, Alignment::Rigid);
    let motion = motion(&poses, &laid).unwrap_or_else(PlanarPose::identity);
    let at = |pose: &PlanarPose| position(&motion.compose(pose));
    plan_svg(scene.plan(), &drawn(map, &at, str::to_owned))
}

/// The motion that takes poses to where they were laid, by the two that lie farthest apart.
fn motion(poses: &[PlanarPose], laid: &[Vector2<f64>]) -> Option<PlanarPose> {
    let first = poses.first()?;
    let far = |pose: &PlanarPose| (position(pose) - position(first)).norm();
    let (last, _) = poses.iter().enumerate().max_by(|a, b| far(a.1).total_cmp(&far(b.1)))?;
    let angle = |way: Vector2<f64>| way.y.atan2(way.x);
    let turn_rad = angle(laid[last] - laid[0]) - angle(position(&poses[last]) - position(first));
    let from = PlanarPose::new(first.x_m(), first.y_m(), 0.0);
    Some(PlanarPose::new(laid[0].x, laid[0].y, turn_rad).compose(&from.inverse()))
}

fn drawn(
    map: &TrueMap,
    at: &impl Fn(&PlanarPose) -> Vector2<f64>,
    name: impl Fn(&str) -> String,
) -> Vec<Layer> {
    let poses = map.mapper.poses();
    let of_place = |place: u32| poses.pose(PlaceId::new(place)).map(at);
    let links = |wanted: fn(SessionId, SessionId) -> bool| {
        let links = map.log.frames().filter_map(|event| Some((event.session, event.link?)));
        let links = links.filter(|(session, link)| {
            let made = [link.from, link.to].map(|place| poses.maker(place).unwrap_or(*session));
            wanted(made[0], made[1])
        });
        links
            .filter_map(|(_, link)| Some((of_place(link.from.number())?, of_place(link.to.number())?, 1.0)))
            .collect()
    };
    let mut layers = Vec::new();
    for (number, session) in map.mapper.map().sessions().map(|(session, _)| session).enumerate() {
        let frames = map.log.frames().filter(|event| event.session == session);
        let path = frames.filter_map(|event| {
            let place = event.decision.place.filter(|&place| poses.part(place) == Some(PlaceId::new(0)))?;
            Some(at(&poses.pose(place)?.compose(event.at?.pose())))
        });
        let name = if number == 0 { name("trajectories") } else { String::new() };
        layers.push(Layer { name, colour: TRAJECTORY.to_owned(), marks: Marks::Path(path.collect()) });
    }
    let links = [
        ("links within a session", WITHIN, links(|a, b| a == b)),
        ("links between sessions", BETWEEN, links(|a, b| a != b)),
    ];
    layers.extend(links.map(|(what, colour, links)| Layer {
        name: name(what),
        colour: colour.to_owned(),
        marks: Marks::Links(links),
    }));
    layers
}
