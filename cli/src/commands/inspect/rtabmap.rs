//! What is in a database of RTAB-Map, and what an import of it would take.

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;
use waypost_bags::rtabmap::{RtabMap, RtabSession};

use super::seconds;
use crate::failure::Failure;
use crate::output::{Output, rounded, table};
use crate::rtab_drive::{open_database, remarks};

/// What `--json` prints.
#[derive(Serialize)]
struct Inspected {
    database: String,
    /// The version of RTAB-Map that made the schema.
    rtabmap: String,
    sessions: Vec<SessionRow>,
    links: Links,
    /// Nodes whose poses RTAB-Map optimised.
    optimized_poses: usize,
    /// What is left out, of no use here, or not as it should be, a sentence each.
    problems: Vec<String>,
}

#[derive(Serialize)]
struct SessionRow {
    map_id: i64,
    nodes: usize,
    frames: usize,
    /// Frames with odometry.
    with_odometry: usize,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    width_px: Option<u32>,
    height_px: Option<u32>,
    /// From frame to frame, by odometry.
    length_m: f64,
    /// Why no camera can be declared; null if one can.
    camera_refused: Option<String>,
}

/// Each pair of nodes once.
#[derive(Serialize)]
struct Links {
    neighbors: u64,
    global_closures: u64,
    nearby_closures: u64,
    user_closures: u64,
    nearby_in_time: u64,
    landmarks: u64,
    other: u64,
}

pub(super) async fn run(path: &Path, output: Output) -> Result<(), Failure> {
    let map = open_database(path, output).await?;
    let counts = map.link_counts();
    let mut problems = remarks(&map);
    for session in map.sessions() {
        if let (Err(reason), true) = (&session.camera, session.frames().next().is_some()) {
            problems.push(format!(
                "map_id {}: the camera is not known: {reason}; `waypost import` needs --camera",
                session.map_id
            ));
        }
    }
    let inspected = Inspected {
        database: path.display().to_string(),
        rtabmap: map.version().to_owned(),
        sessions: map.sessions().iter().map(SessionRow::of).collect(),
        links: Links {
            neighbors: counts.neighbors,
            global_closures: counts.global,
            nearby_closures: counts.nearby,
            user_closures: counts.user,
            nearby_in_time: counts.nearby_in_time,
            landmarks: counts.landmarks,
            other: counts.other,
        },
        optimized_poses: map.optimized().len(),
        problems,
    };
    output.result(&inspected, |out| write(&inspected, &map, out))
}

fn write(inspected: &Inspected, map: &RtabMap, out: &mut dyn Write) -> io::Result<()> {
    let headings = ["MAP_ID", "NODES", "FRAMES", "ODOMETRY", "FROM", "TO", "METRES", "IMAGES"];
    table(out, headings, inspected.sessions.iter().map(SessionRow::cells))?;
    let Links { neighbors, global_closures, nearby_closures, user_closures, .. } = inspected.links;
    writeln!(out)?;
    writeln!(
        out,
        "made by RTAB-Map {}; `waypost import` takes {} frames",
        inspected.rtabmap,
        map.contents().frames
    )?;
    writeln!(
        out,
        "loop closures: {global_closures} global, {nearby_closures} nearby, {user_closures} by people; {neighbors} links to neighbours; \
         {} optimised poses",
        inspected.optimized_poses
    )?;
    inspected.problems.iter().try_for_each(|problem| writeln!(out, "note: {problem}"))
}

impl SessionRow {
    fn of(session: &RtabSession) -> Self {
        let frames: Vec<_> = session.frames().collect();
        let size_px = frames.first().and_then(|node| node.image.ok());
        let positions: Vec<[f64; 3]> =
            frames.iter().filter_map(|node| Some(node.pose.as_ref()?.position_m)).collect();
        let step_m = |step: &[[f64; 3]]| {
            step[0].iter().zip(step[1]).map(|(from, to)| (to - from).powi(2)).sum::<f64>().sqrt()
        };
        Self {
            map_id: session.map_id,
            nodes: session.nodes.len(),
            frames: frames.len(),
            with_odometry: positions.len(),
            first_ns: frames.first().map(|node| node.stamp_ns),
            last_ns: frames.last().map(|node| node.stamp_ns),
            width_px: size_px.map(|(width, _)| width),
            height_px: size_px.map(|(_, height)| height),
            length_m: positions.windows(2).map(step_m).sum(),
            camera_refused: session.camera.as_ref().err().map(ToString::to_string),
        }
    }

    fn cells(&self) -> [String; 8] {
        let size = match (self.width_px, self.height_px) {
            (Some(width), Some(height)) => format!("{width} x {height}"),
            (_, _) => String::new(),
        };
        [
            self.map_id.to_string(),
            self.nodes.to_string(),
            self.frames.to_string(),
            self.with_odometry.to_string(),
            self.first_ns.map_or_else(String::new, seconds),
            self.last_ns.map_or_else(String::new, seconds),
            rounded(self.length_m, 1),
            size,
        ]
    }
}
