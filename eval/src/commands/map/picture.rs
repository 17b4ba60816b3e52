//! The map over the floor plan, as in Bazeille, Battesti and Filliat 2011, figure 1.

use nalgebra::Vector2;
use posegraph::{PlanarPose, Pose};
use topomap::log::{LinkKind, Reason};
use waypost_sim::drawing::{Layer, Marks, plan_svg};

use super::alignment::position;
use super::drive::{Drive, planar};
use super::mapping::Mapped;

/// Raw odometry, the corrected map and the truth, one over the other, laid to where the robot started.
pub(super) fn svg(drive: &Drive, mapped: &Mapped) -> String {
    let start = drive.frames.first().map_or_else(PlanarPose::identity, |frame| frame.truth);
    let poses = mapped.mapper.poses().poses();
    let places: Vec<Vector2<f64>> = poses.iter().map(|pose| position(&start.compose(pose))).collect();
    let ticks = &drive.recording.ticks;
    let truth = ticks.iter().map(|tick| tick.truth.position()).collect();
    let wheels =
        |tick: &waypost_sim::simulation::Tick| position(&start.compose(&planar(&tick.odometry.pose)));
    let links = |wanted: fn(&LinkKind) -> bool| {
        let links = mapped.mapper.map().links().iter().filter(|link| wanted(&link.kind));
        links.map(|link| (places[link.from.index()], places[link.to.index()], 1.0)).collect()
    };
    let recognised = mapped.log.frames().filter(|event| event.decision.reason == Reason::LoopClosure);
    let recognised = recognised.filter_map(|event| Some(places[event.decision.place?.index()])).collect();
    let layers = [
        ("truth", "#1459aa", Marks::Path(truth)),
        ("wheels alone", "#e0a040", Marks::Path(ticks.iter().map(wheels).collect())),
        (
            "map: the way from place to place",
            "#208050",
            Marks::Links(links(|kind| !matches!(kind, LinkKind::Closed(_)))),
        ),
        ("map: places", "#208050", Marks::Dots(places.clone())),
        ("map: loop closures", "#d01020", Marks::Links(links(|kind| matches!(kind, LinkKind::Closed(_))))),
        ("map: places recognised again", "#d01020", Marks::Dots(recognised)),
    ];
    let layers =
        layers.map(|(name, colour, marks)| Layer { name: name.to_owned(), colour: colour.to_owned(), marks });
    plan_svg(drive.scene.plan(), &layers)
}
