//! The byte formats' alphabet, for all that Waypost stores: models, logs, features, snapshots.
//!
//! Little-endian numbers, variable-length integers, and a sealed container with magic, version and
//! SHA-256. Every format built on it is a pure function between bytes and a value, kept beside that
//! value. It lies in this crate because every other crate that stores anything depends on this one.

mod container;
mod error;
mod reader;
mod writer;

pub use container::Container;
pub use error::DecodeError;
pub use reader::Reader;
pub use writer::Writer;

#[cfg(test)]
mod tests;
