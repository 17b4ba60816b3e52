//! The byte form of a snapshot: a map with its model as one checksummed file. Version 2:
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
//!  255  end: number of former models, sessions, events, media and labels as varints, then
//!       the SHA-256 of every byte of the file before it                    one, the last
//! ```
//!
//! Numbers and texts are those of [`fabmap::codec`]. Kinds come in rising order. An event is what
//! `MapEvent::to_bytes` makes, the model what `Model::to_bytes` makes; each has a version of its own.
//! Hashes of models are 64 hexadecimal digits. Kinds of media: 0 features, 1 image, 2 thumbnail.
//!
//! Version 1 has neither labels nor their number in the end; it is read still.

use std::io::{self, Read};

use fabmap::codec::{DecodeError, Reader, Writer};
use sha2::{Digest, Sha256};

use crate::service::models::MAX_MODEL_BYTES;
use crate::storage::{FormerModelRow, LabelRow, MediaRow, MediumKind, StoredSession};

const MAGIC: [u8; 8] = *b"WPSNAP\r\n";
const VERSION: u32 = 2;

/// The first version that has labels.
const WITH_LABELS: u32 = 2;

const MAP: u8 = 1;
const MODEL: u8 = 2;
const FORMER_MODEL: u8 = 3;
const SESSION: u8 = 4;
const EVENT: u8 = 5;
const MEDIUM: u8 = 6;
const LABEL: u8 = 7;
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

/// Writes a snapshot piece by piece.
#[derive(Debug)]
pub(super) struct SnapshotWriter {
    hash: Sha256,
    counts: Counts,
    /// Written and not yet taken.
    bytes: Vec<u8>,
}

impl SnapshotWriter {
    pub(super) fn new() -> Self {
        let mut writer = Self { hash: Sha256::new(), counts: Counts::default(), bytes: Vec::new() };
        writer.put(&MAGIC);
        writer.put(&VERSION.to_le_bytes());
        writer
    }

    /// Adds a record. Records must come in the order that the format has them.
    ///
    /// # Errors
    /// [`DecodeError`] if it is longer than a reader would take.
    pub(super) fn record(&mut self, record: &Record) -> Result<(), DecodeError> {
        let mut writer = Writer::default();
        let counts = &mut self.counts;
        let kind = match record {
            Record::Map(MapRecord { name, model, settings, created_ns }) => {
                writer.str(name);
                writer.str(model);
                writer.str(settings);
                writer.i64(*created_ns);
                MAP
            }
            Record::Model { display_name, file } => {
                writer.str(display_name);
                writer.raw(file);
                MODEL
            }
            Record::FormerModel(FormerModelRow { until_events, model }) => {
                writer.varint(*until_events);
                writer.str(model);
                counts.former_models += 1;
                FORMER_MODEL
            }
            Record::Session(StoredSession { number, name, camera, opened_ns }) => {
                writer.varint(u64::from(*number));
                writer.str(name);
                writer.u8(u8::from(camera.is_some()));
                if let Some(camera) = camera {
                    writer.bytes(camera);
                }
                writer.i64(*opened_ns);
                counts.sessions += 1;
                SESSION
            }
            Record::Event { position, event } => {
                writer.varint(*position);
                writer.raw(event);
                counts.events += 1;
                EVENT
            }
            Record::Medium(MediaRow { position, kind, content }) => {
                writer.varint(*position);
                writer.u8(media_code(*kind));
                writer.raw(content);
                counts.media += 1;
                MEDIUM
            }
            Record::Label(LabelRow { place, label }) => {
                writer.varint(u64::from(*place));
                writer.str(label);
                counts.labels += 1;
                LABEL
            }
        };
        let content = writer.into_bytes();
        let length = u32::try_from(content.len()).unwrap_or(u32::MAX);
        check_length(kind, length)?;
        self.put(&[kind]);
        self.put(&length.to_le_bytes());
        self.put(&content);
        Ok(())
    }

    /// Bytes written and not yet taken.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Takes what was written so far.
    pub(super) fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    /// Ends the snapshot; gives what was not yet taken.
    pub(super) fn finish(mut self) -> Vec<u8> {
        let Counts { former_models, sessions, events, media, labels } = self.counts;
        let mut writer = Writer::default();
        [former_models, sessions, events, media, labels].into_iter().for_each(|count| writer.varint(count));
        let counts = writer.into_bytes();
        self.put(&[END]);
        self.put(&((counts.len() + HASH_BYTES) as u32).to_le_bytes());
        self.put(&counts);
        self.bytes.extend_from_slice(&self.hash.finalize());
        self.bytes
    }

    fn put(&mut self, bytes: &[u8]) {
        self.hash.update(bytes);
        self.bytes.extend_from_slice(bytes);
    }
}

/// Reads a snapshot record by record, and holds it to its format.
#[derive(Debug)]
pub(super) struct SnapshotReader<R> {
    source: R,
    version: u32,
    hash: Sha256,
    counts: Counts,
    /// Kind of the record before, and its key within the kind.
    last: Option<(u8, u64, u8)>,
    bytes: u64,
    ended: bool,
}

impl<R: Read> SnapshotReader<R> {
    /// Reads the beginning.
    pub(super) fn open(source: R) -> Result<Self, SnapshotError> {
        let (counts, hash) = (Counts::default(), Sha256::new());
        let mut reader = Self { source, version: VERSION, hash, counts, last: None, bytes: 0, ended: false };
        let magic = reader.take(MAGIC.len())?;
        if magic != MAGIC {
            return Err(DecodeError::Magic { expected: "Waypost snapshot" }.into());
        }
        let version = reader.take(4)?;
        let found = Reader::new(&version).u32()?;
        if found == 0 || found > VERSION {
            return Err(DecodeError::Version { found, newest: VERSION }.into());
        }
        reader.version = found;
        reader.hash.update(magic);
        reader.hash.update(version);
        Ok(reader)
    }

    /// Bytes read so far.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The next record; none after the end, which was then found to be right.
    pub(super) fn next(&mut self) -> Result<Option<Record>, SnapshotError> {
        if self.ended {
            return Ok(None);
        }
        let header = self.take(5)?;
        let mut reader = Reader::new(&header);
        let (kind, length) = (reader.u8()?, reader.u32()?);
        check_length(kind, length)?;
        let content = self.take(length as usize)?;
        self.hash.update(&header);
        if kind == END {
            self.end(&content)?;
            return Ok(None);
        }
        self.hash.update(&content);
        if kind == LABEL && self.version < WITH_LABELS {
            return Err(no_such_kind(kind).into());
        }
        let record = decode(kind, content)?;
        self.check_order(&record)?;
        Ok(Some(record))
    }

    fn end(&mut self, content: &[u8]) -> Result<(), SnapshotError> {
        let Some((counts, hash)) = content.len().checked_sub(HASH_BYTES).map(|at| content.split_at(at))
        else {
            return Err(DecodeError::invalid("an end without a checksum").into());
        };
        self.hash.update(counts);
        if self.hash.clone().finalize().as_slice() != hash {
            return Err(DecodeError::Checksum.into());
        }
        let mut reader = Reader::new(counts);
        let counts = Counts {
            former_models: reader.varint()?,
            sessions: reader.varint()?,
            events: reader.varint()?,
            media: reader.varint()?,
            labels: if self.version < WITH_LABELS { 0 } else { reader.varint()? },
        };
        reader.end()?;
        if counts != self.counts {
            return Err(DecodeError::invalid("records are missing").into());
        }
        if self.last.is_none_or(|(kind, ..)| kind < MODEL) {
            return Err(DecodeError::invalid("no map, or no model").into());
        }
        let trailing = io::copy(&mut self.source, &mut io::sink()).map_err(SnapshotError::Source)?;
        if trailing > 0 {
            let bytes = usize::try_from(trailing).unwrap_or(usize::MAX);
            return Err(DecodeError::Trailing { bytes }.into());
        }
        self.ended = true;
        Ok(())
    }

    /// Counts a record, and refuses one that is out of order or there twice.
    fn check_order(&mut self, record: &Record) -> Result<(), DecodeError> {
        let counts = &mut self.counts;
        let this = match record {
            Record::Map(_) => (MAP, 0, 0),
            Record::Model { .. } => (MODEL, 0, 0),
            Record::FormerModel(former) => {
                counts.former_models += 1;
                (FORMER_MODEL, former.until_events, 0)
            }
            Record::Session(session) => {
                counts.sessions += 1;
                (SESSION, u64::from(session.number), 0)
            }
            Record::Event { position, .. } => {
                if *position != counts.events {
                    return Err(DecodeError::invalid(format_args!(
                        "event {position} where {} should be",
                        counts.events
                    )));
                }
                counts.events += 1;
                (EVENT, *position, 0)
            }
            Record::Medium(medium) => {
                counts.media += 1;
                (MEDIUM, medium.position, media_code(medium.kind))
            }
            Record::Label(label) => {
                counts.labels += 1;
                (LABEL, u64::from(label.place), 0)
            }
        };
        let in_order = match self.last {
            None => this.0 == MAP,
            Some((MAP, ..)) => this.0 == MODEL,
            Some(last) => last < this,
        };
        if !in_order {
            return Err(DecodeError::invalid(format_args!(
                "a record of kind {} out of order, or there twice",
                this.0
            )));
        }
        self.last = Some(this);
        Ok(())
    }

    /// The next bytes. No more memory is taken than there are bytes.
    fn take(&mut self, count: usize) -> Result<Vec<u8>, SnapshotError> {
        let mut bytes = Vec::new();
        let wanted = count as u64;
        (&mut self.source).take(wanted).read_to_end(&mut bytes).map_err(SnapshotError::Source)?;
        self.bytes += bytes.len() as u64;
        if bytes.len() < count {
            return Err(DecodeError::Truncated { needed: count - bytes.len() }.into());
        }
        Ok(bytes)
    }
}

fn check_length(kind: u8, length: u32) -> Result<(), DecodeError> {
    let most = if kind == MODEL { MAX_MODEL_RECORD_BYTES } else { MAX_RECORD_BYTES };
    if length > most {
        return Err(DecodeError::invalid(format_args!("a record of kind {kind} with {length} bytes")));
    }
    Ok(())
}

fn decode(kind: u8, content: Vec<u8>) -> Result<Record, DecodeError> {
    let mut reader = Reader::new(&content);
    let record = match kind {
        MAP => Record::Map(MapRecord {
            name: reader.str()?.to_owned(),
            model: reader.str()?.to_owned(),
            settings: reader.str()?.to_owned(),
            created_ns: reader.i64()?,
        }),
        MODEL => {
            let display_name = reader.str()?.to_owned();
            let rest = reader.remaining();
            return Ok(Record::Model { display_name, file: last(content, rest) });
        }
        FORMER_MODEL => {
            let until_events = reader.varint()?;
            Record::FormerModel(FormerModelRow { until_events, model: reader.str()?.to_owned() })
        }
        SESSION => Record::Session(StoredSession {
            number: reader.varint_u32()?,
            name: reader.str()?.to_owned(),
            camera: match reader.u8()? {
                0 => None,
                1 => Some(reader.bytes()?.to_vec()),
                other => return Err(DecodeError::invalid(format_args!("flag {other}"))),
            },
            opened_ns: reader.i64()?,
        }),
        EVENT => {
            let position = reader.varint()?;
            let rest = reader.remaining();
            return Ok(Record::Event { position, event: last(content, rest) });
        }
        MEDIUM => {
            let (position, kind) = (reader.varint()?, media_kind(reader.u8()?)?);
            let rest = reader.remaining();
            return Ok(Record::Medium(MediaRow { position, kind, content: last(content, rest) }));
        }
        LABEL => Record::Label(LabelRow { place: reader.varint_u32()?, label: reader.str()?.to_owned() }),
        other => return Err(no_such_kind(other)),
    };
    reader.end()?;
    Ok(record)
}

fn no_such_kind(kind: u8) -> DecodeError {
    DecodeError::invalid(format_args!("a record of kind {kind}"))
}

/// The last `count` bytes.
fn last(mut bytes: Vec<u8>, count: usize) -> Vec<u8> {
    let before = bytes.len() - count;
    bytes.drain(..before);
    bytes
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
