//! The tables of RTAB-Map's SQLite, read and never written.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags, OptionalExtension, Row};

use super::error::RtabError;
use super::matrix::{NUMBERS, pose_of};
use super::packed;
use super::version::Version;
use crate::messages::Pose;

/// The longest image that is read: one of 16 megapixels in colour.
pub(super) const MOST_IMAGE_BYTES: u64 = crate::input::MOST_MESSAGE_BYTES;

const MAGIC: &[u8] = b"SQLite format 3\0";
/// What of the head of a file says how long it is.
const HEAD_BYTES: usize = 32;

/// Tables that every database of RTAB-Map has.
const TABLES: [&str; 6] = ["Admin", "Node", "Data", "Link", "Word", "Info"];

const OF_ROSBAG2: &str = "It is a bag of rosbag2: `waypost stream` takes it, if its name ends in .db3";
const OF_ANOTHER: &str = "Give the file that RTAB-Map wrote, as ~/.ros/rtabmap.db";

/// A node with its data, as written.
pub(super) struct NodeRow<'a> {
    pub(super) id: i64,
    pub(super) map_id: i64,
    pub(super) stamp_s: f64,
    pub(super) pose: &'a [u8],
    pub(super) ground_truth: &'a [u8],
    pub(super) calibration: &'a [u8],
    /// None if there is none, or one that is too long.
    pub(super) image: Option<&'a [u8]>,
    pub(super) image_bytes: u64,
    pub(super) depth_bytes: u64,
    pub(super) scan_bytes: u64,
    pub(super) grid_bytes: u64,
    pub(super) user_data_bytes: u64,
    pub(super) gps_bytes: u64,
    pub(super) sensor_bytes: u64,
}

/// A link, as written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LinkRow {
    pub(super) from: i64,
    pub(super) to: i64,
    pub(super) kind: i64,
}

/// Rows of tables that are counted alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tables {
    pub(super) words: u64,
    pub(super) features: u64,
    pub(super) global_descriptors: u64,
}

pub(super) struct Database {
    path: PathBuf,
    connection: Connection,
}

impl Database {
    /// Opens a file, and reads all of it to see that it is whole.
    pub(super) fn open(path: &Path) -> Result<Self, RtabError> {
        check_length(path)?;
        let database = Self::open_again(path)?;
        database.check_tables()?;
        let told: String = database.asked("PRAGMA quick_check(1)", |row| row.get(0))?.unwrap_or_default();
        if told != "ok" {
            return Err(RtabError::Damaged { path: path.to_owned(), problem: told });
        }
        Ok(database)
    }

    /// Opens a file that was checked.
    pub(super) fn open_again(path: &Path) -> Result<Self, RtabError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags);
        let connection =
            connection.map_err(|source| RtabError::Database { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), connection })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    fn failed(&self, source: rusqlite::Error) -> RtabError {
        RtabError::Database { path: self.path.clone(), source }
    }

    fn damaged(&self, problem: String) -> RtabError {
        RtabError::Damaged { path: self.path.clone(), problem }
    }

    /// The first row of an answer, if there is any.
    fn asked<T>(
        &self,
        query: &str,
        read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Option<T>, RtabError> {
        self.connection.query_row(query, [], read).optional().map_err(|error| self.failed(error))
    }

    fn has_table(&self, name: &str) -> Result<bool, RtabError> {
        // Views of those names could go on for ever.
        let query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ?1 AND sql LIKE 'CREATE TABLE %'";
        let count = self.connection.query_row(query, [name], |row| row.get::<_, i64>(0));
        Ok(count.map_err(|error| self.failed(error))? == 1)
    }

    fn has_column(&self, table: &str, column: &str) -> Result<bool, RtabError> {
        let query = "SELECT count(*) FROM pragma_table_info(?1) WHERE name = ?2";
        let count = self.connection.query_row(query, [table, column], |row| row.get::<_, i64>(0));
        Ok(count.map_err(|error| self.failed(error))? == 1)
    }

    fn check_tables(&self) -> Result<(), RtabError> {
        for missing in TABLES {
            if !self.has_table(missing)? {
                let is_bag = self.has_table("topics")? && self.has_table("messages")?;
                let mend = if is_bag { OF_ROSBAG2 } else { OF_ANOTHER };
                return Err(RtabError::AnotherProgram { path: self.path.clone(), missing, mend });
            }
        }
        Ok(())
    }

    pub(super) fn version(&self) -> Result<Version, RtabError> {
        let version: Option<Option<String>> =
            self.asked("SELECT version FROM Admin LIMIT 1", |row| row.get(0))?;
        let version = version.flatten().unwrap_or_default();
        Version::parse(&version).map_err(|mend| RtabError::Version { path: self.path.clone(), version, mend })
    }

    /// RTAB-Map's parameters, as `name:value;name:value`.
    pub(super) fn parameters(&self) -> Result<String, RtabError> {
        let query = "SELECT parameters FROM Info ORDER BY rowid DESC LIMIT 1";
        Ok(self.asked(query, |row| row.get::<_, Option<String>>(0))?.flatten().unwrap_or_default())
    }

    /// Passes all nodes to `visit`, by their ids.
    pub(super) fn nodes(&self, visit: &mut dyn FnMut(&NodeRow<'_>)) -> Result<(), RtabError> {
        let sensors = if self.has_column("Node", "env_sensors")? { "length(Node.env_sensors)" } else { "0" };
        let query = format!(
            "SELECT Node.id, Node.map_id, Node.stamp, Node.pose, Node.ground_truth_pose, Data.calibration, \
             CASE WHEN length(Data.image) <= {MOST_IMAGE_BYTES} THEN Data.image END, length(Data.image), \
             length(Data.depth), length(Data.scan), \
             coalesce(length(Data.ground_cells), 0) + coalesce(length(Data.obstacle_cells), 0) + \
             coalesce(length(Data.empty_cells), 0), \
             length(Data.user_data), length(Node.gps), {sensors} \
             FROM Node LEFT JOIN Data ON Data.id = Node.id ORDER BY Node.id"
        );
        let failed = |error| self.failed(error);
        let mut statement = self.connection.prepare(&query).map_err(failed)?;
        let mut rows = statement.query([]).map_err(failed)?;
        while let Some(row) = rows.next().map_err(failed)? {
            let row = NodeRow {
                id: row.get(0).map_err(failed)?,
                map_id: row.get(1).map_err(failed)?,
                stamp_s: row.get::<_, Option<f64>>(2).map_err(failed)?.unwrap_or(0.0),
                pose: blob(row, 3).map_err(failed)?.unwrap_or_default(),
                ground_truth: blob(row, 4).map_err(failed)?.unwrap_or_default(),
                calibration: blob(row, 5).map_err(failed)?.unwrap_or_default(),
                image: blob(row, 6).map_err(failed)?,
                image_bytes: length(row, 7).map_err(failed)?,
                depth_bytes: length(row, 8).map_err(failed)?,
                scan_bytes: length(row, 9).map_err(failed)?,
                grid_bytes: length(row, 10).map_err(failed)?,
                user_data_bytes: length(row, 11).map_err(failed)?,
                gps_bytes: length(row, 12).map_err(failed)?,
                sensor_bytes: length(row, 13).map_err(failed)?,
            };
            visit(&row);
        }
        Ok(())
    }

    pub(super) fn image(&self, node: i64) -> Result<Option<Vec<u8>>, RtabError> {
        let query = "SELECT image FROM Data WHERE id = ?1 AND length(image) <= ?2";
        let parameters = (node, MOST_IMAGE_BYTES as i64);
        let image = self.connection.query_row(query, parameters, |row| row.get::<_, Option<Vec<u8>>>(0));
        Ok(image.optional().map_err(|error| self.failed(error))?.flatten())
    }

    pub(super) fn links(&self) -> Result<Vec<LinkRow>, RtabError> {
        let failed = |error| self.failed(error);
        let mut statement =
            self.connection.prepare("SELECT from_id, to_id, type FROM Link").map_err(failed)?;
        let rows = statement
            .query_map([], |row| Ok(LinkRow { from: row.get(0)?, to: row.get(1)?, kind: row.get(2)? }))
            .map_err(failed)?;
        rows.collect::<rusqlite::Result<_>>().map_err(failed)
    }

    pub(super) fn tables(&self) -> Result<Tables, RtabError> {
        let count = |table: &str| -> Result<u64, RtabError> {
            if !self.has_table(table)? {
                return Ok(0);
            }
            let count = self.asked(&format!("SELECT count(*) FROM {table}"), |row| row.get::<_, i64>(0))?;
            Ok(count.unwrap_or(0).unsigned_abs())
        };
        Ok(Tables {
            words: count("Word")?,
            features: count("Feature")?,
            global_descriptors: count("GlobalDescriptor")?,
        })
    }

    /// Where nodes are by RTAB-Map's last optimisation; landmarks, which have numbers below 0, are none.
    pub(super) fn optimized(&self) -> Result<BTreeMap<i64, Pose>, RtabError> {
        let query = "SELECT opt_ids, opt_poses FROM Admin LIMIT 1";
        let written = self
            .asked(query, |row| Ok((row.get::<_, Option<Vec<u8>>>(0)?, row.get::<_, Option<Vec<u8>>>(1)?)))?;
        let Some((Some(ids), Some(poses))) = written else { return Ok(BTreeMap::new()) };
        if ids.is_empty() || poses.is_empty() {
            return Ok(BTreeMap::new());
        }
        let damaged = |problem: String| self.damaged(format!("its optimised poses: {problem}"));
        let (ids, poses) =
            (packed::integers(&ids).map_err(damaged)?, packed::floats(&poses).map_err(damaged)?);
        let (poses, rest) = poses.as_chunks::<NUMBERS>();
        if poses.len() != ids.len() || !rest.is_empty() {
            return Err(damaged(format!("there are {} of them for {} nodes", poses.len(), ids.len())));
        }
        let known = ids.into_iter().zip(poses).filter(|(id, _)| *id > 0);
        Ok(known.filter_map(|(id, pose)| Some((i64::from(id), pose_of(pose)?))).collect())
    }
}

/// SQLite itself tells of a file that was cut off only where it looks for what is missing.
fn check_length(path: &Path) -> Result<(), RtabError> {
    let failed = |source| RtabError::File { path: path.to_owned(), source };
    let file = File::open(path).map_err(failed)?;
    let is_bytes = file.metadata().map_err(failed)?.len();
    let mut head = Vec::new();
    file.take(HEAD_BYTES as u64).read_to_end(&mut head).map_err(failed)?;
    if !head.starts_with(MAGIC) {
        return Err(RtabError::NotADatabase(path.to_owned()));
    }
    // Of SQLite's file format: the size of a page (1 stands for 65536), and how many there are.
    let needed_bytes = match head.as_slice() {
        [.., p1, p0, _, _, _, _, _, _, _, _, _, _, c3, c2, c1, c0] if head.len() == HEAD_BYTES => {
            let page_bytes = match u16::from_be_bytes([*p1, *p0]) {
                1 => 1 << 16,
                other => u64::from(other),
            };
            page_bytes * u64::from(u32::from_be_bytes([*c3, *c2, *c1, *c0]))
        }
        _ => HEAD_BYTES as u64,
    };
    if is_bytes < needed_bytes {
        return Err(RtabError::CutOff { path: path.to_owned(), is_bytes, needed_bytes });
    }
    Ok(())
}

fn blob<'a>(row: &'a Row<'_>, index: usize) -> rusqlite::Result<Option<&'a [u8]>> {
    Ok(row.get_ref(index)?.as_blob_or_null()?)
}

fn length(row: &Row<'_>, index: usize) -> rusqlite::Result<u64> {
    Ok(row.get::<_, Option<i64>>(index)?.unwrap_or(0).unsigned_abs())
}
