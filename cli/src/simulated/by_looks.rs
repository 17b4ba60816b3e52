//! A simulated drive of a robot that sees all around, streamed into a map by looks, and held against the truth.

use std::collections::BTreeMap;

use waypost_client::{Client, v1};
use waypost_sim::drawing::{Layer, Marks};
use waypost_sim::drive::Building;
use waypost_sim::pose::Pose;
use waypost_sim::simulation::Recording;

use super::mapping::{Answered, stream_along};
use crate::failure::Failure;
use crate::output::Output;

/// What the server made of the drive.
pub(crate) struct MappedByLooks {
    /// maps/{map}/sessions/{session}
    pub(crate) session: String,
    pub(crate) map: v1::Map,
    /// Links of the map's appearance graph, those to other sessions among them.
    pub(crate) links: usize,
    /// Links between places of this drive: where the robot really was at their ends, and their similarity.
    pub(crate) own_links: Vec<(Pose, Pose, f64)>,
    /// Where it really was when it made its places.
    places: BTreeMap<u32, Pose>,
}

/// Streams panoramas without odometry into a session of a map that is navigated by looks.
pub(crate) async fn map_by_looks(
    client: &Client,
    map: &str,
    session: &str,
    building: &Building,
    recording: &Recording,
    output: Output,
) -> Result<MappedByLooks, Failure> {
    let Answered { session, closures: _, places } =
        stream_along(client, map, session, building, recording, output).await?;
    let graph = client.appearance_graph(map).await?;
    let own_links = graph.links.iter().filter_map(|link| {
        let [from, to] = [link.from_place_number, link.to_place_number].map(|place| places.get(&place));
        Some((*from?, *to?, link.similarity))
    });
    let own_links = own_links.collect();
    let map = client.map(map, v1::MapView::Full).await?;
    Ok(MappedByLooks { session, map, links: graph.links.len(), own_links, places })
}

impl MappedByLooks {
    /// How far the ends of the drive's links really are from each other: the median and the most, in metres.
    pub(crate) fn apart_m(&self) -> Option<(f64, f64)> {
        let mut apart_m: Vec<f64> = self.own_links.iter().map(|(from, to, _)| from.distance_m(to)).collect();
        apart_m.sort_by(f64::total_cmp);
        Some((*apart_m.get(apart_m.len() / 2)?, *apart_m.last()?))
    }

    /// The truth, and what looks alike, for a picture.
    pub(crate) fn layers(&self, recording: &Recording) -> Vec<Layer> {
        let truth = recording.ticks.iter().map(|tick| tick.truth.position()).collect();
        let links =
            self.own_links.iter().map(|(from, to, similarity)| (from.position(), to.position(), *similarity));
        let places = self.places.values().map(Pose::position).collect();
        [
            ("links by looks, the darker the more alike", "#208050", Marks::Links(links.collect())),
            ("truth", "#1459aa", Marks::Path(truth)),
            ("places", "#d01020", Marks::Dots(places)),
        ]
        .map(|(name, colour, marks)| Layer { name: name.to_owned(), colour: colour.to_owned(), marks })
        .to_vec()
    }
}
