//! Why a bag cannot be read, and where.

use std::io;
use std::path::PathBuf;

use crate::bytes::Malformed;

/// Why a bag cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// It is no bag, or one of a kind that is not read.
    #[error("{} is no bag: {reason}", path.display())]
    NotABag {
        /// File or folder.
        path: PathBuf,
        /// What was expected.
        reason: String,
    },
    /// The system could not read it.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// What is there contradicts the format.
    #[error("{} is damaged at byte {at_byte}: {problem}; nothing of it was used. {mend}", path.display())]
    Damaged {
        /// File.
        path: PathBuf,
        /// Of the file, or of what a compressed file holds.
        at_byte: u64,
        /// What is wrong there.
        problem: String,
        /// How to mend it.
        mend: &'static str,
    },
    /// SQLite could not read the database.
    #[error(
        "{} cannot be read as a rosbag2 database: {source}; nothing of it was used. \
         `sqlite3 FILE .recover` may save what is whole", path.display()
    )]
    Database {
        /// File.
        path: PathBuf,
        /// What SQLite said.
        source: rusqlite::Error,
    },
    /// The bag is not the one that was read before.
    #[error("{} changed while it was read; start again", path.display())]
    Changed {
        /// File or folder.
        path: PathBuf,
    },
    /// The topics that a use needs are not there, or are not clear.
    #[error(transparent)]
    Choice(#[from] ChoiceError),
}

/// Why no topics could be chosen.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChoiceError {
    /// A topic that was asked for is not in the bag.
    #[error("there is no topic {topic}; the bag has {}", present.join(", "))]
    NoTopic {
        /// As it was asked for.
        topic: String,
        /// What there is.
        present: Vec<String>,
    },
    /// A topic that was asked for is of a type that does not serve.
    #[error("{topic} is of type {type_name}; {flag} takes {wanted}")]
    WrongType {
        /// As it was asked for.
        topic: String,
        /// The type of its messages.
        type_name: String,
        /// The flag that named it.
        flag: &'static str,
        /// Types that serve.
        wanted: &'static str,
    },
    /// A topic of transforms does not say where the robot is by odometry.
    #[error(
        "{topic} has no transform from odom to base_link or base_footprint, which odometry is; it has {present}; name another \
         topic with --odometry-topic, or none"
    )]
    NoMotion {
        /// As it was asked for.
        topic: String,
        /// What transforms it has in place of that.
        present: String,
    },
    /// A topic has messages of two types.
    #[error("{topic} changes its type from {first} to {second}; a topic of one type is needed")]
    TypeChanges {
        /// The topic.
        topic: String,
        /// The type that it has first.
        first: String,
        /// Another.
        second: String,
    },
    /// Several topics serve.
    #[error("several topics have {what}: {}; name one with {flag}", topics.join(", "))]
    Several {
        /// What they have.
        what: &'static str,
        /// Their names.
        topics: Vec<String>,
        /// The flag that chooses.
        flag: &'static str,
    },
    /// No topic has images.
    #[error("no topic has images that can be read: {reason}")]
    NoImages {
        /// What there is in place of them.
        reason: String,
    },
    /// The static transforms go in a circle.
    #[error(
        "the transforms of tf_static go in a circle at {frame}; record them anew, or leave the camera out with --camera-info-topic none"
    )]
    TransformLoop {
        /// A frame of the circle.
        frame: String,
    },
}

/// A message that is left out, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftOut {
    /// How many messages of the topic are left out.
    pub count: u64,
    /// Number of the first of them in its topic, from 1.
    pub first_number: u64,
    /// When the first of them was recorded.
    pub first_log_ns: i64,
    /// What is wrong with the first of them.
    pub first_problem: Problem,
}

/// What is wrong with a message.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Its bytes are not of its type.
    #[error(transparent)]
    Malformed(#[from] Malformed),
    /// It is longer than what is read.
    #[error("it has {size_bytes} bytes; messages of up to {limit_bytes} are read")]
    TooLong {
        /// Its length.
        size_bytes: u64,
        /// The longest that is read.
        limit_bytes: u64,
    },
    /// What a message is compressed to cannot be read.
    #[error("its compression cannot be read: {0}")]
    Compression(String),
    /// Its encoding is not read.
    #[error("its message encoding `{0}` is not read; cdr and ros1 are")]
    Encoding(String),
    /// It holds no JPEG or PNG.
    #[error("it is neither JPEG nor PNG (its format says `{0}`)")]
    Format(String),
    /// Pixels of an encoding that is not read.
    #[error("pixels of encoding `{0}` are not read; mono8, rgb8, bgr8, rgba8, bgra8 and bayer of 8 bits are")]
    Pixels(String),
    /// The sizes of an image contradict each other.
    #[error(
        "{width_px} x {height_px} pixels in rows of {step_bytes} bytes do not fit its {size_bytes} bytes"
    )]
    Shape {
        /// Width.
        width_px: u32,
        /// Height.
        height_px: u32,
        /// Length of a row.
        step_bytes: u32,
        /// Length of the pixels.
        size_bytes: usize,
    },
    /// The image has no stamp.
    #[error("its header has no stamp above 0; --stamps log takes the times of recording")]
    NoStamp,
    /// The clock went back, or stood.
    #[error(
        "its stamp {stamp_ns} is not above the {before_ns} of one before; --stamps log takes the times of recording"
    )]
    NotRising {
        /// Of the message.
        stamp_ns: i64,
        /// The highest before.
        before_ns: i64,
    },
    /// A single stamp far from those around it.
    #[error(
        "its stamp {stamp_ns} does not follow the {before_ns} of one before, as the next ones do; --stamps log takes the times of \
         recording"
    )]
    Astray {
        /// Of the message.
        stamp_ns: i64,
        /// Of the latest that is used.
        before_ns: i64,
    },
    /// A pose has numbers that are none, or no rotation.
    #[error("its pose is none: its numbers have to be finite and its quaternion of length 1")]
    NotAPose,
}
