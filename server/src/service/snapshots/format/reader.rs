//! A snapshot in.

use std::io::{self, Read};

use fabmap::codec::{DecodeError, Reader};
use sha2::{Digest, Sha256};

use super::{
    Counts, END, EVENT, FORMER_MODEL, HASH_BYTES, LABEL, MAGIC, MAP, MEDIUM, MODEL, MapRecord, NOTE, Record,
    SESSION, SnapshotError, VERSION, WITH_CAMERA_BYTES, WITH_LABELS, WITH_NOTES, check_length, media_code,
    media_kind,
};
use crate::camera::{Camera, from_message};
use crate::storage::{FormerModelRow, LabelRow, MediaRow, NoteRow, StoredSession};

/// Reads a snapshot record by record, and holds it to its format.
#[derive(Debug)]
pub(in crate::service::snapshots) struct SnapshotReader<R> {
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
    pub(in crate::service::snapshots) fn open(source: R) -> Result<Self, SnapshotError> {
        let counts = Counts::default();
        let hash = Sha256::new();
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
    pub(in crate::service::snapshots) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The next record; none after the end, which was then found to be right.
    pub(in crate::service::snapshots) fn next(&mut self) -> Result<Option<Record>, SnapshotError> {
        if self.ended {
            return Ok(None);
        }
        let header = self.take(5)?;
        let mut reader = Reader::new(&header);
        let kind = reader.u8()?;
        let length = reader.u32()?;
        check_length(kind, length)?;
        let content = self.take(length as usize)?;
        self.hash.update(&header);
        if kind == END {
            self.end(&content)?;
            return Ok(None);
        }
        self.hash.update(&content);
        let since = [(LABEL, WITH_LABELS), (NOTE, WITH_NOTES)];
        if since.into_iter().any(|(since_then, version)| kind == since_then && self.version < version) {
            return Err(no_such_kind(kind).into());
        }
        let record = decode(kind, content, self.version)?;
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
            notes: if self.version < WITH_NOTES { 0 } else { reader.varint()? },
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
            Record::Note(note) => {
                counts.notes += 1;
                (NOTE, note.position, 0)
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

fn decode(kind: u8, content: Vec<u8>, version: u32) -> Result<Record, DecodeError> {
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
                1 => Some(camera(reader.bytes()?, version)?),
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
            let position = reader.varint()?;
            let kind = media_kind(reader.u8()?)?;
            let rest = reader.remaining();
            return Ok(Record::Medium(MediaRow { position, kind, content: last(content, rest) }));
        }
        LABEL => Record::Label(LabelRow { place: reader.varint_u32()?, label: reader.str()?.to_owned() }),
        NOTE => Record::Note(NoteRow { position: reader.varint()?, note: reader.str()?.to_owned() }),
        other => return Err(no_such_kind(other)),
    };
    reader.end()?;
    Ok(record)
}

fn camera(bytes: &[u8], version: u32) -> Result<Camera, DecodeError> {
    if version >= WITH_CAMERA_BYTES {
        return Camera::from_bytes(bytes);
    }
    from_message(bytes).ok_or_else(|| DecodeError::invalid("a camera that is none"))
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
