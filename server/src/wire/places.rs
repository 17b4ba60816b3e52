//! Places, their labels and the graph of them as messages.

use fabmap::PlaceId;
use waypost_proto::v1;

use super::geometry::planar_pose;
use super::references::frame_reference;
use crate::error::ServiceError;
use crate::names::place_name;
use crate::open_map::answers::{PlacePose, WordPlace};
use crate::open_map::appearance::LinkView;
use crate::service::appearance::{GraphView, NodeView};
use crate::service::labels::LabelRow;
use crate::service::maps::{PlaceBounds, PlaceView, PlacesWanted};

pub(crate) fn place(map: &str, view: PlaceView) -> v1::Place {
    let PlaceView { place, looks, word_hits, frames, linked, pose } = view;
    v1::Place {
        name: place_name(map, place.number()),
        looks: u32::from(looks),
        words: u32::try_from(word_hits.len()).unwrap_or(u32::MAX),
        frames: frames.into_iter().map(frame_reference).collect(),
        linked_place_numbers: linked.into_iter().map(PlaceId::number).collect(),
        word_hits: word_hits
            .into_iter()
            .map(|(word, hits)| v1::PlaceWord { word: word.into(), hits: hits.into() })
            .collect(),
        pose: pose.map(|PlacePose { part, pose }| v1::PlacePose {
            part: part.number(),
            pose: Some(planar_pose(&pose)),
        }),
    }
}

/// As it is in a list: without its words.
pub(crate) fn listed_place(map: &str, view: PlaceView) -> v1::Place {
    v1::Place { word_hits: Vec::new(), ..place(map, view) }
}

/// Which places a list is to have, from what both doors take.
pub(crate) fn places_wanted(
    every: u32,
    from: u32,
    to: Option<u32>,
    within: Option<v1::PlaceBounds>,
) -> Result<PlacesWanted, ServiceError> {
    let within = within.map(|v1::PlaceBounds { part, min_x_m, min_y_m, max_x_m, max_y_m }| {
        let ordered = |low: f64, high: f64| low <= high;
        if ordered(min_x_m, max_x_m) && ordered(min_y_m, max_y_m) {
            return Ok(PlaceBounds {
                part: PlaceId::new(part),
                x_m: [min_x_m, max_x_m],
                y_m: [min_y_m, max_y_m],
            });
        }
        Err(ServiceError::invalid(
            "places lie within min_x_m to max_x_m and min_y_m to max_y_m; the second of each must not be the smaller",
        ))
    });
    let within = within.transpose()?;
    Ok(PlacesWanted { from: PlaceId::new(from), to: to.map(PlaceId::new), every: every.max(1), within })
}

pub(crate) fn word_place(found: WordPlace) -> v1::WordPlace {
    let WordPlace { place, hits, looks } = found;
    v1::WordPlace { place_number: place.number(), hits: hits.into(), looks: looks.into() }
}

pub(crate) fn labels(map: &str, rows: Vec<LabelRow>) -> Vec<v1::PlaceLabel> {
    let label = |LabelRow { place, label }| v1::PlaceLabel { place: place_name(map, place.number()), label };
    rows.into_iter().map(label).collect()
}

pub(crate) fn graph(view: GraphView) -> v1::AppearanceGraph {
    let GraphView { map, nodes, links } = view;
    let node =
        |NodeView { place, space, label }| v1::AppearanceNode { place_number: place.number(), space, label };
    let link = |LinkView { from, to, similarity }| v1::AppearanceLink {
        from_place_number: from.number(),
        to_place_number: to.number(),
        similarity,
    };
    v1::AppearanceGraph {
        map,
        nodes: nodes.into_iter().map(node).collect(),
        links: links.into_iter().map(link).collect(),
    }
}
