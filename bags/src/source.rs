//! Files of messages: what all kinds of bags have in common.

use std::ops::ControlFlow;
use std::path::Path;

use crate::bytes::Encoding;
use crate::error::BagError;
use crate::input::{Fault, Input, Progress};

mod compression;
mod mcap;
mod ros1;
mod sqlite;

/// What messages of one kind come under.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Channel {
    pub(crate) topic: String,
    /// As the file names it; empty if it does not.
    pub(crate) type_name: String,
    pub(crate) encoding: Encoding,
}

/// What a message holds.
pub(crate) enum Body<'a> {
    Whole(&'a [u8]),
    /// It has more bytes than are read.
    TooLong(u64),
    /// It is compressed for itself, and that cannot be read.
    Unreadable(String),
}

/// A message as it is stored.
pub(crate) struct RawMessage<'a> {
    pub(crate) channel: &'a Channel,
    /// When it was recorded.
    pub(crate) log_ns: i64,
    pub(crate) body: Body<'a>,
}

/// Takes messages one after another, in the order in which they were recorded.
pub(crate) type Visit<'v> = dyn FnMut(&RawMessage<'_>) -> Result<ControlFlow<()>, BagError> + 'v;

/// How the reading of a file ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// All of it was read, or as much as was wanted.
    Whole,
    /// The file ends in the middle: what is before that was read.
    CutOff {
        /// Where.
        at_byte: u64,
    },
}

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    /// MCAP
    Mcap,
    /// rosbag2's database
    Sqlite,
    /// ROS 1, version 2.0
    Ros1,
}

impl Format {
    /// By the end of a file's name, before that of a compression.
    pub(crate) fn of(path: &Path) -> Option<Self> {
        let plain = if crate::input::is_compressed(path) { path.with_extension("") } else { path.to_owned() };
        match plain.extension()?.to_string_lossy().to_lowercase().as_str() {
            "mcap" => Some(Format::Mcap),
            "db3" => Some(Format::Sqlite),
            "bag" => Some(Format::Ros1),
            _ => None,
        }
    }
}

/// Passes each message of a file to `visit`, until that breaks off.
pub(crate) fn visit_file(
    format: Format,
    path: &Path,
    progress: &mut Progress<'_>,
    visit: &mut Visit<'_>,
) -> Result<Ending, BagError> {
    match format {
        Format::Mcap => read_through(Input::open(path, progress)?, MEND_MCAP, |input, at_byte| {
            mcap::read(input, at_byte, visit)
        }),
        Format::Ros1 => read_through(Input::open(path, progress)?, MEND_ROS1, |input, at_byte| {
            ros1::read(input, at_byte, visit)
        }),
        Format::Sqlite => sqlite::read(path, progress, visit),
    }
}

const MEND_MCAP: &str = "`mcap recover` may save what is whole";
const MEND_ROS1: &str = "`rosbag reindex` or `rosbag fix` may save what is whole";

/// Reads a stream of records; `at_byte` is kept at the record that is being read.
fn read_through(
    mut input: Input<'_, '_>,
    mend: &'static str,
    read: impl FnOnce(&mut Input<'_, '_>, &mut u64) -> Result<(), Fault>,
) -> Result<Ending, BagError> {
    let mut at_byte = 0;
    let fault = match read(&mut input, &mut at_byte) {
        Ok(()) => return Ok(Ending::Whole),
        Err(Fault::Bag(error)) => return Err(error),
        Err(Fault::Ended) if input.has_ended() => return Ok(Ending::CutOff { at_byte: input.position() }),
        Err(fault) => fault,
    };
    let problem = match fault {
        Fault::Ended => "a chunk ends in the middle of a record".to_owned(),
        Fault::Unreadable(error) => format!("it cannot be read or decompressed: {error}"),
        Fault::Wrong(problem) => problem,
        Fault::Bag(error) => return Err(error),
    };
    Err(BagError::Damaged { path: input.path().to_owned(), at_byte, problem, mend })
}
