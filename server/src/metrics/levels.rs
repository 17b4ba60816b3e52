//! What metrics tell that is not counted, but as it is when they are read.

use crate::ingest::extraction::Help;
use crate::quotas::{Refusals, Used};
use crate::storage::FleetLevels;

/// What is looked at when the metrics are read, rather than counted.
#[derive(Clone, Debug)]
pub(crate) struct Levels {
    pub(crate) open_maps: usize,
    pub(crate) jobs_running: usize,
    /// `None` if the database does not answer.
    pub(crate) database_bytes: Option<u64>,
    /// What is left of the disk that the database is on; `None` if that cannot be told.
    pub(crate) disk_free_bytes: Option<u64>,
    /// Robots that are led, by their status.
    pub(crate) robots_led: Vec<(&'static str, usize)>,
    pub(crate) queues: QueueLengths,
    /// What other servers do for this one.
    pub(crate) help: Help,
    /// `None` for SQLite.
    pub(crate) fleet: Option<FleetLevels>,
    /// What there is of what quotas may limit, whosever it is.
    pub(crate) used: Used,
    pub(crate) refusals: Refusals,
    pub(crate) process: ProcessLevels,
}

/// What waits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct QueueLengths {
    /// Images that wait for a core, or are on one.
    pub(crate) images: usize,
    /// Robots that were refused for want of room, and have a time at which to come again.
    pub(crate) robots_in_line: usize,
    /// Requests that wait for the writers of the open maps.
    pub(crate) maps: usize,
}

/// What the process takes; `None` where the system does not tell.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ProcessLevels {
    pub(crate) resident_bytes: Option<u64>,
    pub(crate) cpu_seconds: Option<f64>,
}
