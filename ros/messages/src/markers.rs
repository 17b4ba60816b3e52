//! Places, links, labels and loop closures, as markers.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use waypost_proto::v1;

use crate::messages::{CompressedImage, Header, Message, Pose, Time, Vector3};

const PLACE: [f32; 4] = [0.2, 0.5, 1.0, 1.0];
const LINK: [f32; 4] = [0.6, 0.6, 0.6, 1.0];
const CLOSURE: [f32; 4] = [1.0, 0.6, 0.0, 1.0];
const LABEL: [f32; 4] = [1.0, 1.0, 1.0, 1.0];

/// What a marker is, by visualization_msgs/Marker.
const LINE_LIST: i32 = 5;
const SPHERE_LIST: i32 = 7;
const TEXT_VIEW_FACING: i32 = 9;
const ADD: i32 = 0;
const DELETE_ALL: i32 = 3;

/// visualization_msgs/MarkerArray, as ROS has it since Humble.
#[derive(Clone, Debug, Serialize)]
pub struct MarkerArray {
    markers: Vec<Marker>,
}

impl Message for MarkerArray {
    const TYPE: &'static str = "visualization_msgs/msg/MarkerArray";
}

/// visualization_msgs/Marker
#[derive(Clone, Debug, Default, Serialize)]
struct Marker {
    header: Header,
    ns: String,
    id: i32,
    kind: i32,
    action: i32,
    pose: Pose,
    scale: Vector3,
    color: [f32; 4],
    /// 0 is for ever.
    lifetime: Time,
    frame_locked: bool,
    points: Vec<Vector3>,
    colors: Vec<[f32; 4]>,
    texture_resource: String,
    texture: CompressedImage,
    uv_coordinates: Vec<[f32; 2]>,
    text: String,
    mesh_resource: String,
    mesh_file: MeshFile,
    mesh_use_embedded_materials: bool,
}

/// visualization_msgs/MeshFile
#[derive(Clone, Debug, Default, Serialize)]
struct MeshFile {
    filename: String,
    data: Vec<u8>,
}

/// What is known of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DrawnMap {
    /// The part whose places are drawn: each has a frame of its own.
    pub part: u32,
    /// All of them: those of other parts are left out.
    pub places: Vec<v1::Place>,
    /// What places are called.
    pub labels: Vec<v1::PlaceLabel>,
    /// Loop closures, whose places are marked.
    pub closures: Vec<v1::LoopClosure>,
}

/// A loop closure that is told when it was made: from the robot to the place that it recognised.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Tells it from others.
    pub id: i32,
    /// The robot, in metres.
    pub from: Vector3,
    /// The place that it recognised.
    pub to: Vector3,
    /// What is written at the robot.
    pub text: String,
}

impl MarkerArray {
    /// The places of a part of the map, and what is known of them, in place of all markers before.
    pub fn of_map(header: &Header, map: &DrawnMap) -> Self {
        let DrawnMap { part: _, places, labels, closures } = map;
        let positions = map.positions();
        let at = |number: &u32| positions.get(number).copied();
        let linked = places.iter().filter_map(|place| Some((place, number(&place.name)?)));
        let links = linked.flat_map(|(place, from)| {
            // Each link once.
            let later = place.linked_place_numbers.iter().filter(move |to| **to > from);
            later.filter_map(move |to| Some([at(&from)?, at(to)?]))
        });
        let closed: BTreeSet<u32> = closures.iter().map(|closure| closure.place_number).collect();
        let list = |ns: &str, kind, size_m, color, points| Marker {
            kind,
            color,
            points,
            scale: Vector3 { x: size_m, y: size_m, z: size_m },
            ..marker(header, ns, 0)
        };
        let mut markers = vec![
            Marker { action: DELETE_ALL, ..marker(header, "", 0) },
            list("places", SPHERE_LIST, 0.15, PLACE, positions.values().copied().collect()),
            list("links", LINE_LIST, 0.03, LINK, links.flatten().collect()),
            list("closures", SPHERE_LIST, 0.25, CLOSURE, closed.iter().filter_map(at).collect()),
        ];
        markers.extend(labels.iter().filter_map(|label| {
            let number = number(&label.place)?;
            let Vector3 { x, y, z } = at(&number)?;
            let pose = Pose { position: Vector3 { x, y, z: z + 0.4 }, ..Pose::ORIGIN };
            let scale = Vector3 { z: 0.3, ..Vector3::default() };
            let id = i32::try_from(number).unwrap_or(i32::MAX);
            let text = label.label.clone();
            Some(Marker {
                kind: TEXT_VIEW_FACING,
                pose,
                scale,
                color: LABEL,
                text,
                ..marker(header, "labels", id)
            })
        }));
        Self { markers }
    }

    /// A loop closure.
    pub fn of_closure(header: &Header, Line { id, from, to, text }: Line) -> Self {
        let width = Vector3 { x: 0.05, ..Vector3::default() };
        let line = Marker {
            kind: LINE_LIST,
            scale: width,
            color: CLOSURE,
            points: vec![from, to],
            ..marker(header, "closures", id)
        };
        let above = Vector3 { z: from.z + 0.5, ..from };
        let told = Marker {
            kind: TEXT_VIEW_FACING,
            pose: Pose { position: above, ..Pose::ORIGIN },
            scale: Vector3 { z: 0.25, ..Vector3::default() },
            color: CLOSURE,
            text,
            ..marker(header, "closures' probability", id)
        };
        Self { markers: vec![line, told] }
    }
}

impl DrawnMap {
    /// Where the places of the part are, by their numbers.
    #[must_use]
    pub fn positions(&self) -> BTreeMap<u32, Vector3> {
        let of = |place: &v1::Place| {
            let pose = place.pose.as_ref().filter(|pose| pose.part == self.part)?;
            Some((number(&place.name)?, Pose::of(pose.pose.as_ref()?)?.position))
        };
        self.places.iter().filter_map(of).collect()
    }
}

fn marker(header: &Header, ns: &str, id: i32) -> Marker {
    Marker { header: header.clone(), ns: ns.to_owned(), id, action: ADD, ..Marker::default() }
}

/// The number at the end of a place's name.
fn number(place: &str) -> Option<u32> {
    place.rsplit('/').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(number: u32, part: u32, x: f64, linked: &[u32]) -> v1::Place {
        let pose = v1::Pose {
            position_m: Some(v1::Vector3 { x, ..v1::Vector3::default() }),
            orientation: Some(v1::Quaternion { w: 1.0, ..v1::Quaternion::default() }),
        };
        v1::Place {
            name: format!("maps/hall/places/{number}"),
            linked_place_numbers: linked.to_vec(),
            pose: Some(v1::PlacePose { part, pose: Some(pose) }),
            ..v1::Place::default()
        }
    }

    #[test]
    fn only_the_robots_part_is_drawn_and_each_link_once() {
        let label = v1::PlaceLabel { place: "maps/hall/places/1".to_owned(), label: "door".to_owned() };
        let map = DrawnMap {
            part: 0,
            places: vec![place(0, 0, 0.0, &[1]), place(1, 0, 1.0, &[0, 2]), place(2, 2, 9.0, &[1])],
            labels: vec![label],
            closures: vec![v1::LoopClosure { place_number: 1, ..v1::LoopClosure::default() }],
        };
        let MarkerArray { markers } = MarkerArray::of_map(&Header::new(1, "map"), &map);
        let drawn: Vec<(&str, i32, usize)> =
            markers.iter().map(|marker| (marker.ns.as_str(), marker.kind, marker.points.len())).collect();
        let expected = [
            ("", 0, 0),
            ("places", SPHERE_LIST, 2),
            ("links", LINE_LIST, 2),
            ("closures", SPHERE_LIST, 1),
            ("labels", TEXT_VIEW_FACING, 0),
        ];
        assert_eq!(drawn, expected);
        assert_eq!((markers[0].action, markers[4].text.as_str(), markers[4].id), (DELETE_ALL, "door", 1));
    }
}
