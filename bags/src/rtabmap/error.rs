//! Why a database of RTAB-Map cannot be read, and why a node is no frame.

use std::io;
use std::path::PathBuf;

/// Why nothing of a database can be used.
#[derive(Debug, thiserror::Error)]
pub enum RtabError {
    /// The system could not read it.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It is none of SQLite.
    #[error("{} is no database: it does not begin as SQLite does; give RTAB-Map's file, as ~/.ros/rtabmap.db", .0.display())]
    NotADatabase(PathBuf),
    /// Another program's.
    #[error("{} is a database of another program: it has no table {missing}, which RTAB-Map's have. {mend}", path.display())]
    AnotherProgram {
        /// The file.
        path: PathBuf,
        /// The first table that is missing.
        missing: &'static str,
        /// How to mend it.
        mend: &'static str,
    },
    /// A schema that is not read.
    #[error("{} has the schema of RTAB-Map {version}; those of 0.17 to 0.23 are read. {mend}", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// As it says.
        version: String,
        /// How to mend it.
        mend: &'static str,
    },
    /// It ends too early.
    #[error(
        "{} is cut off: {is_bytes} of {needed_bytes} bytes are there; nothing of it was used. Copy it anew, once RTAB-Map has ended",
        path.display()
    )]
    CutOff {
        /// The file.
        path: PathBuf,
        /// Its length.
        is_bytes: u64,
        /// What its head says.
        needed_bytes: u64,
    },
    /// What is in it contradicts itself.
    #[error("{} is damaged: {problem}; nothing of it was used. `rtabmap-recovery FILE` may save what is whole", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// SQLite could not read it.
    #[error(
        "{} cannot be read: {source}; nothing of it was used. End the RTAB-Map that writes into it, or copy it anew; \
         `sqlite3 FILE .recover` may save what is whole", path.display()
    )]
    Database {
        /// The file.
        path: PathBuf,
        /// What SQLite said.
        source: rusqlite::Error,
    },
    /// There is nothing in it.
    #[error("{} has no nodes: RTAB-Map made it and saw nothing; give one that a robot has driven with", .0.display())]
    NoNodes(PathBuf),
    /// Nothing was kept that could be recognised.
    #[error(
        "{} has {nodes} nodes and not one image that can be used: {first}. RTAB-Map keeps images where its parameter \
         Mem/BinDataKept is true and a camera is subscribed; record it anew so", path.display()
    )]
    NoImages {
        /// The file.
        path: PathBuf,
        /// How many nodes there are.
        nodes: u64,
        /// Of the first one.
        first: Omitted,
    },
    /// It is not the one that was read before.
    #[error("{} changed while it was read; start again once RTAB-Map has ended", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
}

/// Why a node is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Omitted {
    /// Nothing was kept.
    #[error("it has no image")]
    NoImage,
    /// What was kept is no image that is read.
    #[error("its image is neither JPEG nor PNG")]
    Format,
    /// Its image says of itself what cannot be.
    #[error("its image has no readable head")]
    Head,
    /// It is larger than what is read.
    #[error("its image has more than 64 MiB")]
    TooLong,
    /// Images of several cameras, side by side in one.
    #[error("its image is of several cameras, side by side")]
    SeveralCameras,
    /// No time.
    #[error("it has no stamp above 0")]
    NoStamp,
    /// The clock went back, or stood.
    #[error("its stamp is not above that of the node before")]
    NotRising,
}
