//! Places, links, labels and loop closures, as markers.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use serde::Serialize;
use waypost_client::{Client, Error, v1};

use crate::bus::Outgoing;
use crate::messages::{Header, Message, Pose, Time, Vector3};
use crate::state::Shared;

/// At most this often; and a map that is fetched slowly is fetched seldom.
const PERIOD: Duration = Duration::from_secs(2);
const PAUSE_PER_FETCH: u32 = 20;
/// Also a map that this robot does not change may change.
const ANYWAY: Duration = Duration::from_secs(30);

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
pub(crate) struct MarkerArray {
    markers: Vec<Marker>,
}

impl Message for MarkerArray {
    const TYPE: &'static str = "visualization_msgs::msg::dds_::MarkerArray_";
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
    texture: Texture,
    uv_coordinates: Vec<[f32; 2]>,
    text: String,
    mesh_resource: String,
    mesh_file: MeshFile,
    mesh_use_embedded_materials: bool,
}

/// sensor_msgs/CompressedImage
#[derive(Clone, Debug, Default, Serialize)]
struct Texture {
    header: Header,
    format: String,
    data: Vec<u8>,
}

/// visualization_msgs/MeshFile
#[derive(Clone, Debug, Default, Serialize)]
struct MeshFile {
    filename: String,
    data: Vec<u8>,
}

/// Publishes a map as markers whenever it has grown.
pub(crate) struct Markers {
    pub(crate) client: Client,
    pub(crate) map: String,
    pub(crate) map_frame: String,
    pub(crate) shared: Shared,
    pub(crate) out: Outgoing<MarkerArray>,
}

impl Markers {
    pub(crate) async fn run(self) {
        let mut told: Option<(Instant, u64, u32)> = None;
        let mut pause = PERIOD;
        loop {
            tokio::time::sleep(pause).await;
            let (answered, part) = self.known();
            let is_due = told.is_none_or(|(at, told_answered, told_part)| {
                (told_answered, told_part) != (answered, part) || at.elapsed() > ANYWAY
            });
            if !is_due {
                continue;
            }
            let began = Instant::now();
            match self.fetch(part).await {
                Ok(markers) => {
                    self.out.publish(markers);
                    told = Some((began, answered, part));
                }
                // The session tells of a server that is away.
                Err(error) => tracing::debug!("no markers: {error}"),
            }
            pause = PERIOD.max(began.elapsed() * PAUSE_PER_FETCH);
        }
    }

    /// Answers so far, and the part of the map that the robot is in.
    fn known(&self) -> (u64, u32) {
        let state = self.shared.lock();
        (state.frames.answered, state.placed.as_ref().map_or(0, |placed| placed.part))
    }

    async fn fetch(&self, part: u32) -> Result<MarkerArray, Error> {
        let places = self.client.places(&self.map).await?;
        let labels = self.client.labels(&self.map).await?;
        let closures = self.client.loop_closures(&self.map).await?;
        let stamp_ns = self.shared.lock().robot_now_ns().unwrap_or(0);
        Ok(drawn(&Header::new(stamp_ns, &self.map_frame), &Map { part, places, labels, closures }))
    }
}

struct Map {
    part: u32,
    places: Vec<v1::Place>,
    labels: Vec<v1::PlaceLabel>,
    closures: Vec<v1::LoopClosure>,
}

/// The places of a part of the map, and what is known of them.
fn drawn(header: &Header, Map { part, places, labels, closures }: &Map) -> MarkerArray {
    let positions: BTreeMap<u32, Vector3> = places
        .iter()
        .filter_map(|place| {
            let pose = place.pose.as_ref().filter(|pose| pose.part == *part)?;
            Some((number(&place.name)?, Pose::of(pose.pose.as_ref()?)?.position))
        })
        .collect();
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
    MarkerArray { markers }
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
        let map = Map {
            part: 0,
            places: vec![place(0, 0, 0.0, &[1]), place(1, 0, 1.0, &[0, 2]), place(2, 2, 9.0, &[1])],
            labels: vec![label],
            closures: vec![v1::LoopClosure { place_number: 1, ..v1::LoopClosure::default() }],
        };
        let MarkerArray { markers } = drawn(&Header::new(1, "map"), &map);
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
