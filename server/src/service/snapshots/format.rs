//! The byte form of a snapshot: a map with its model as one checksummed file. Version 4:
//!
//! ```text
//! snapshot = "WPSNAP\r\n"  version u32  record*
//! record   = kind u8  length u32  content (length bytes)
//!
//! kind  content                                                            how many, in which order
//!    1  map: name, hash of its model, settings (JSON), created_ns i64      one, the first
//!    2  model: display name, then the model file up to the end             one
//!    3  former model: until_events varint, hash                            rising until_events
//!    4  session: number varint, name, flag u8, camera if 1, opened_ns i64  rising number
//!    5  event: position varint, then the event up to the end               0, 1, 2, …
//!    6  medium: position varint, kind u8, then the content up to the end   rising position, kind
//!    7  label: place varint, what people call it                           rising place
//!    8  note: position varint, what its robot calls the frame              rising position
//!  255  end: number of former models, sessions, events, media, labels and notes as varints, then
//!       the SHA-256 of every byte of the file before it                    one, the last
//! ```
//!
//! Numbers and texts are those of [`fabmap::codec`]. Kinds come in rising order. An event is what
//! `MapEvent::to_bytes` makes, the model what `Model::to_bytes` makes; each has a version of its own.
//! Hashes of models are 64 hexadecimal digits. Kinds of media: 0 features, 1 image, 2 thumbnail.
//!
//! A camera is what `Camera::to_bytes` makes. In versions 1 and 2 it is the message that the robot sent, as it was then;
//! version 1 has neither labels nor their number in the end, and versions before 4 neither notes nor theirs. All are read
//! still.

mod reader;
mod writer;

use std::io;

use fabmap::codec::DecodeError;

pub(super) use self::reader::SnapshotReader;
pub(super) use self::writer::SnapshotWriter;
use crate::service::models::MAX_MODEL_BYTES;
use crate::storage::{FormerModelRow, LabelRow, MediaRow, MediumKind, NoteRow, StoredSession};

const MAGIC: [u8; 8] = *b"WPSNAP\r\n";
const VERSION: u32 = 4;

/// The first version that has labels.
const WITH_LABELS: u32 = 2;

/// The first version whose cameras have a byte form of their own.
const WITH_CAMERA_BYTES: u32 = 3;

/// The first version that has notes.
const WITH_NOTES: u32 = 4;

const MAP: u8 = 1;
const MODEL: u8 = 2;
const FORMER_MODEL: u8 = 3;
const SESSION: u8 = 4;
const EVENT: u8 = 5;
const MEDIUM: u8 = 6;
const LABEL: u8 = 7;
const NOTE: u8 = 8;
const END: u8 = 255;

const HASH_BYTES: usize = 32;

/// Longest model record: a model file and its name.
const MAX_MODEL_RECORD_BYTES: u32 = MAX_MODEL_BYTES as u32 + (1 << 10);

/// Longest record of any other kind. Images are the longest, and have 4 MiB.
const MAX_RECORD_BYTES: u32 = 16 << 20;

/// One part of a snapshot.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Record {
    Map(MapRecord),
    Model { display_name: String, file: Vec<u8> },
    FormerModel(FormerModelRow),
    Session(StoredSession),
    Event { position: u64, event: Vec<u8> },
    Medium(MediaRow),
    Label(LabelRow),
    Note(NoteRow),
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct MapRecord {
    pub(super) name: String,
    /// Hash of its model.
    pub(super) model: String,
    /// JSON.
    pub(super) settings: String,
    pub(super) created_ns: i64,
}

/// How many records of each kind there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    former_models: u64,
    sessions: u64,
    events: u64,
    media: u64,
    labels: u64,
    notes: u64,
}

/// Why a snapshot cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum SnapshotError {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The source itself failed, not what is in it.
    #[error("the file could not be read: {0}")]
    Source(io::Error),
}

fn check_length(kind: u8, length: u32) -> Result<(), DecodeError> {
    let most = if kind == MODEL { MAX_MODEL_RECORD_BYTES } else { MAX_RECORD_BYTES };
    if length > most {
        return Err(DecodeError::invalid(format_args!("a record of kind {kind} with {length} bytes")));
    }
    Ok(())
}

fn media_code(kind: MediumKind) -> u8 {
    match kind {
        MediumKind::Features => 0,
        MediumKind::Image => 1,
        MediumKind::Thumbnail => 2,
    }
}

fn media_kind(code: u8) -> Result<MediumKind, DecodeError> {
    match code {
        0 => Ok(MediumKind::Features),
        1 => Ok(MediumKind::Image),
        2 => Ok(MediumKind::Thumbnail),
        other => Err(DecodeError::invalid(format_args!("a medium of kind {other}"))),
    }
}

#[cfg(test)]
mod tests;
