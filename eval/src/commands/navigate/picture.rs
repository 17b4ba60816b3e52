//! Ways over the floor plan, as in Bazeille, Battesti and Filliat 2011, figure 4.

use waypost_sim::drawing::{Layer, Marks, plan_svg};

use super::repeat::Drive;
use super::teaching::Taught;

/// The way that was taught, the way by wheels alone and the way by camera, with where places were recognised.
pub(super) fn svg(taught: &Taught, seen: &Drive, by_wheels: Option<&Drive>) -> String {
    let closures = seen.looks.iter().filter(|look| look.on_the_way && look.recognised.is_some());
    let closures = closures.map(|look| look.position).collect();
    let layer =
        |name: &str, colour: &str, marks| Layer { name: name.to_owned(), colour: colour.to_owned(), marks };
    let mut layers = vec![layer("taught", "#208050", Marks::Path(taught.path()))];
    layers.extend(
        by_wheels.map(|drive| layer("driven by wheels alone", "#e0a040", Marks::Path(drive.path.clone()))),
    );
    layers.push(layer("driven by camera and wheels", "#1459aa", Marks::Path(seen.path.clone())));
    layers.push(layer("places recognised", "#d01020", Marks::Dots(closures)));
    plan_svg(taught.drive.scene.plan(), &layers)
}
