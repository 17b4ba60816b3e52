//! RTAB-Map's databases: what was seen, where its robot was by odometry, and what RTAB-Map made of it.
//!
//! [`RtabMap::open`] checks a file and lists what is in it; [`RtabMap::read_images`] hands out images one after another.
//! Schemas of 0.17 to 0.23 are read. Their layout is told by RTAB-Map's `DatabaseSchema.sql`, `CameraModel` and
//! `compressData`.

mod calibration;
mod contents;
mod database;
mod error;
mod links;
mod matrix;
mod packed;
mod version;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

pub use self::calibration::NoCamera;
pub use self::contents::Contents;
use self::database::Database;
pub use self::error::{Omitted, RtabError};
pub use self::links::{Closure, ClosureKind, LinkCounts};
use self::links::{Links, closures_of};
use crate::camera::Camera;
use crate::messages::Pose;

/// A database that was checked and listed.
#[derive(Debug)]
pub struct RtabMap {
    path: PathBuf,
    version: String,
    sessions: Vec<RtabSession>,
    closures: Vec<Closure>,
    link_counts: LinkCounts,
    optimized: BTreeMap<i64, Pose>,
    contents: Contents,
}

/// The nodes of one drive: those of one `map_id`.
#[derive(Clone, Debug, PartialEq)]
pub struct RtabSession {
    /// RTAB-Map's `map_id`.
    pub map_id: i64,
    /// By their ids, which rise.
    pub nodes: Vec<RtabNode>,
    /// The camera of the first frame, or why none can be declared.
    pub camera: Result<Camera, NoCamera>,
    /// Nodes with frames whose calibration is not that of the first one.
    pub other_calibrations: u64,
}

/// A node: a moment of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct RtabNode {
    /// RTAB-Map's.
    pub id: i64,
    /// When it was.
    pub stamp_ns: i64,
    /// The robot's base by odometry, as it was before any optimisation; none where odometry was lost.
    pub pose: Option<Pose>,
    /// Width and height of its image, or why it is no frame.
    pub image: Result<(u32, u32), Omitted>,
}

/// Takes images one after another: the node's number in its session, the node, and its image.
pub type TakeImage<'t> = dyn FnMut(u64, &RtabNode, Vec<u8>) -> ControlFlow<()> + 't;

impl RtabSession {
    /// The nodes that are frames.
    pub fn frames(&self) -> impl Iterator<Item = &RtabNode> {
        self.nodes.iter().filter(|node| node.image.is_ok())
    }
}

impl RtabMap {
    /// Whether a path names such a database, by the end of its name.
    #[must_use]
    pub fn is_database(path: &Path) -> bool {
        path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("db"))
    }

    /// Checks all of a database, and says what is in it. Images are read one at a time.
    ///
    /// # Errors
    /// [`RtabError`], where nothing of it can be used.
    pub fn open(path: &Path) -> Result<Self, RtabError> {
        let database = Database::open(path)?;
        let version = database.version()?;
        let (sessions, contents) = contents::survey(&database, &version)?;
        let Links { closures, counts } = closures_of(&database)?;
        let optimized = database.optimized()?;
        let version = version.text;
        Ok(Self {
            path: path.to_owned(),
            version,
            sessions,
            closures,
            link_counts: counts,
            optimized,
            contents,
        })
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The version of RTAB-Map that made the schema.
    #[must_use]
    pub fn version(&self) -> &str {
        &self.version
    }

    /// By their `map_id`.
    #[must_use]
    pub fn sessions(&self) -> &[RtabSession] {
        &self.sessions
    }

    /// What RTAB-Map took for the same place, each pair once.
    #[must_use]
    pub fn closures(&self) -> &[Closure] {
        &self.closures
    }

    /// How many links there are of each kind.
    #[must_use]
    pub fn link_counts(&self) -> &LinkCounts {
        &self.link_counts
    }

    /// Where nodes are by RTAB-Map's last optimisation; empty where the database has none.
    #[must_use]
    pub fn optimized(&self) -> &BTreeMap<i64, Pose> {
        &self.optimized
    }

    /// What there is, and what of it is of no use here.
    #[must_use]
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// Passes each node of a session that is a frame, with its image, to `take`, above number `after` of the session's
    /// nodes (from 1), until that breaks off.
    ///
    /// # Errors
    /// [`RtabError::Changed`] where the database is not any more what it was when it was opened.
    pub fn read_images(
        &self,
        session: &RtabSession,
        after: u64,
        take: &mut TakeImage<'_>,
    ) -> Result<(), RtabError> {
        let database = Database::open_again(&self.path)?;
        for (number, node) in (1..).zip(&session.nodes) {
            if number <= after || node.image.is_err() {
                continue;
            }
            let image = database.image(node.id)?;
            let size_px = image.as_deref().and_then(|image| contents::size_px(image).ok());
            let image = image.filter(|_| size_px.ok_or(Omitted::NoImage) == node.image);
            let image = image.ok_or_else(|| RtabError::Changed { path: self.path.clone() })?;
            if take(number, node, image).is_break() {
                break;
            }
        }
        Ok(())
    }
}
