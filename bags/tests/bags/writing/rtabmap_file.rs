//! Databases of RTAB-Map, by its published schemas of 0.17 to 0.23.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use rusqlite::Connection;

/// The upper three rows of a transform's matrix.
pub type Rows = [f32; 12];

/// A camera that looks ahead from 0.2 m before the robot's middle, in its optical frame.
pub const LOOKS_AHEAD: Rows = [0.0, 0.0, 1.0, 0.2, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.3];

/// A node, and what of its data matters here.
#[derive(Clone, Default)]
pub struct Node {
    pub id: i64,
    pub map_id: i64,
    pub stamp_s: f64,
    /// Zeros where odometry was lost.
    pub pose: Rows,
    pub image: Option<Vec<u8>>,
    pub depth: Option<Vec<u8>>,
    pub scan: Option<Vec<u8>>,
    pub calibration: Vec<u8>,
}

/// What a database holds.
#[derive(Clone, Default)]
pub struct Drive {
    pub nodes: Vec<Node>,
    /// From, to, type: written from either end, as RTAB-Map does.
    pub links: Vec<(i64, i64, i64)>,
    pub optimized: Vec<(i32, Rows)>,
    pub parameters: String,
}

/// A pose on the floor.
pub fn on_the_floor(x_m: f32, y_m: f32, heading_rad: f32) -> Rows {
    let (sine, cosine) = heading_rad.sin_cos();
    [cosine, -sine, 0.0, x_m, sine, cosine, 0.0, y_m, 0.0, 0.0, 1.0, 0.0]
}

/// The calibration of one camera without distortion, as a version writes it.
pub fn calibration(minor: u32, [fx, fy, cx, cy]: [f64; 4], (width, height): (u32, u32)) -> Vec<u8> {
    let transform = LOOKS_AHEAD.iter().flat_map(|value| value.to_le_bytes());
    if minor < 18 {
        let numbers = [fx, fy, cx, cy, f64::from(width), f64::from(height)];
        return numbers.iter().flat_map(|value| (*value as f32).to_le_bytes()).chain(transform).collect();
    }
    let head = [0, minor as i32, 0, 0, width as i32, height as i32, 9, 0, 0, 0, 12];
    let matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    let head = head.iter().flat_map(|value: &i32| value.to_le_bytes());
    head.chain(matrix.iter().flat_map(|value: &f64| value.to_le_bytes())).chain(transform).collect()
}

/// A matrix as `compressData` packs it: zlib, then rows, columns and type.
pub fn packed(data: &[u8], columns: usize, kind: i32) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(data).unwrap();
    let tail = [1, columns as i32, kind].map(i32::to_le_bytes).concat();
    [encoder.finish().unwrap(), tail].concat()
}

fn bytes(rows: &Rows) -> Vec<u8> {
    rows.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Writes a database of a version, as `0.21.4`.
pub fn rtabmap(path: &Path, version: &str, drive: &Drive) {
    let minor: u32 = version.split('.').nth(1).unwrap().parse().unwrap();
    let database = Connection::open(path).unwrap();
    let since = |first: u32, column: &'static str| if minor >= first { column } else { "" };
    let tables = format!(
        "CREATE TABLE Node(id INTEGER NOT NULL, map_id INTEGER NOT NULL, weight INTEGER, stamp FLOAT, pose BLOB, \
         ground_truth_pose BLOB, velocity BLOB, label TEXT, gps BLOB, {} time_enter DATE, PRIMARY KEY (id)); \
         CREATE TABLE Data(id INTEGER NOT NULL, image BLOB, depth BLOB, {} calibration BLOB, scan BLOB, scan_info BLOB, \
         ground_cells BLOB, obstacle_cells BLOB, empty_cells BLOB, cell_size FLOAT, view_point_x FLOAT, \
         view_point_y FLOAT, view_point_z FLOAT, user_data BLOB, time_enter DATE, PRIMARY KEY (id)); \
         CREATE TABLE Link(from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, type INTEGER NOT NULL, /* kVirtualClosure=5 */ \
         information_matrix BLOB NOT NULL, transform BLOB, user_data BLOB); \
         CREATE TABLE Word(id INTEGER NOT NULL, descriptor_size INTEGER NOT NULL, descriptor BLOB NOT NULL, \
         time_enter DATE, PRIMARY KEY (id)); \
         CREATE TABLE Feature(node_id INTEGER NOT NULL, word_id INTEGER NOT NULL, pos_x FLOAT NOT NULL, \
         pos_y FLOAT NOT NULL, size INTEGER NOT NULL, dir FLOAT NOT NULL, response FLOAT NOT NULL, \
         octave INTEGER NOT NULL, depth_x FLOAT, depth_y FLOAT, depth_z FLOAT, descriptor_size INTEGER, descriptor BLOB); \
         {} \
         CREATE TABLE Info(STM_size INTEGER, last_sign_added INTEGER, process_mem_used INTEGER, \
         database_mem_used INTEGER, dictionary_size INTEGER, parameters TEXT, time_enter DATE); \
         CREATE TABLE Statistics(id INTEGER NOT NULL, stamp FLOAT, data BLOB, wm_state BLOB); \
         CREATE TABLE Admin(version TEXT, preview_image BLOB, opt_cloud BLOB, opt_ids BLOB, opt_poses BLOB, \
         opt_last_localization BLOB, opt_polygons_size INTEGER, opt_polygons BLOB, opt_tex_coords BLOB, \
         opt_tex_materials BLOB, opt_map BLOB, opt_map_x_min FLOAT, opt_map_y_min FLOAT, opt_map_resolution FLOAT, \
         {} time_enter DATE);",
        since(18, "env_sensors BLOB,"),
        since(22, "depth_confidence BLOB,"),
        since(
            20,
            "CREATE TABLE GlobalDescriptor(node_id INTEGER NOT NULL, type INTEGER NOT NULL, info BLOB, data BLOB NOT NULL);"
        ),
        since(23, "dictionary_index BLOB,"),
    );
    database.execute_batch(&tables).unwrap();
    for Node { id, map_id, stamp_s, pose, image, depth, scan, calibration } in &drive.nodes {
        database
            .execute(
                "INSERT INTO Node(id, map_id, weight, stamp, pose, ground_truth_pose) VALUES (?1, ?2, 0, ?3, ?4, ?5)",
                (id, map_id, stamp_s, bytes(pose), bytes(&[0.0; 12])),
            )
            .unwrap();
        database
            .execute(
                "INSERT INTO Data(id, image, depth, scan, calibration) VALUES (?1, ?2, ?3, ?4, ?5)",
                (id, image, depth, scan, calibration),
            )
            .unwrap();
    }
    for (from, to, kind) in &drive.links {
        for (from, to) in [(from, to), (to, from)] {
            database
                .execute(
                    "INSERT INTO Link(from_id, to_id, type, information_matrix) VALUES (?1, ?2, ?3, ?4)",
                    (from, to, kind, [0; 288]),
                )
                .unwrap();
        }
    }
    database.execute("INSERT INTO Info(STM_size, parameters) VALUES (0, ?1)", [&drive.parameters]).unwrap();
    let ids: Vec<u8> = drive.optimized.iter().flat_map(|(id, _)| id.to_le_bytes()).collect();
    let poses: Vec<u8> = drive.optimized.iter().flat_map(|(_, rows)| bytes(rows)).collect();
    let count = drive.optimized.len();
    let optimized = (count > 0).then(|| (packed(&ids, count, 4), packed(&poses, 12 * count, 5)));
    let (ids, poses) = optimized.unzip();
    database
        .execute("INSERT INTO Admin(version, opt_ids, opt_poses) VALUES (?1, ?2, ?3)", (version, ids, poses))
        .unwrap();
}
