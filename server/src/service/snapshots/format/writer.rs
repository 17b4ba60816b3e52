//! A snapshot out.

use fabmap::codec::{DecodeError, Writer};
use sha2::{Digest, Sha256};

use super::{
    Counts, END, EVENT, FORMER_MODEL, HASH_BYTES, LABEL, MAGIC, MAP, MEDIUM, MODEL, MapRecord, NOTE, Record,
    SESSION, VERSION, check_length, media_code,
};
use crate::storage::{FormerModelRow, LabelRow, MediaRow, NoteRow, StoredSession};

/// Writes a snapshot piece by piece.
#[derive(Debug)]
pub(in crate::service::snapshots) struct SnapshotWriter {
    hash: Sha256,
    counts: Counts,
    /// Written and not yet taken.
    bytes: Vec<u8>,
}

impl SnapshotWriter {
    pub(in crate::service::snapshots) fn new() -> Self {
        let mut writer = Self { hash: Sha256::new(), counts: Counts::default(), bytes: Vec::new() };
        writer.put(&MAGIC);
        writer.put(&VERSION.to_le_bytes());
        writer
    }

    /// Adds a record. Records must come in the order that the format has them.
    ///
    /// # Errors
    /// [`DecodeError`] if it is longer than a reader would take.
    pub(in crate::service::snapshots) fn record(&mut self, record: &Record) -> Result<(), DecodeError> {
        let (kind, content) = self.counted(record);
        let length = u32::try_from(content.len()).unwrap_or(u32::MAX);
        check_length(kind, length)?;
        self.put(&[kind]);
        self.put(&length.to_le_bytes());
        self.put(&content);
        Ok(())
    }

    /// Kind and content of a record, which counts from then on.
    fn counted(&mut self, record: &Record) -> (u8, Vec<u8>) {
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
                    writer.bytes(&camera.to_bytes());
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
            Record::Note(NoteRow { position, note }) => {
                writer.varint(*position);
                writer.str(note);
                counts.notes += 1;
                NOTE
            }
        };
        (kind, writer.into_bytes())
    }

    /// Bytes written and not yet taken.
    pub(in crate::service::snapshots) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Takes what was written so far.
    pub(in crate::service::snapshots) fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    /// Ends the snapshot; gives what was not yet taken.
    pub(in crate::service::snapshots) fn finish(mut self) -> Vec<u8> {
        let Counts { former_models, sessions, events, media, labels, notes } = self.counts;
        let mut writer = Writer::default();
        let counts = [former_models, sessions, events, media, labels, notes];
        counts.into_iter().for_each(|count| writer.varint(count));
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
