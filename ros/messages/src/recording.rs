//! Messages in a file, as MCAP.

use std::collections::HashMap;
use std::collections::btree_map::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use crate::definitions::definition;
use crate::messages::{Message, encoded};

/// Why a message was not recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be written.
    #[error("the recording cannot be written: {0}")]
    File(#[from] mcap::McapError),
    /// A message has something that CDR cannot say.
    #[error("a message cannot be laid out: {0}")]
    Layout(#[from] cdr_encoding::Error),
}

/// A recording that is being written: chunks by zstd with checksums, and an index behind them.
pub struct Recording<W: Write + Seek> {
    writer: Writer<W>,
    schemas: HashMap<&'static str, u16>,
    /// By topic, with the number of messages so far.
    channels: HashMap<String, (u16, u32)>,
}

impl<W: Write + Seek> Recording<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// [`RecordingError::File`].
    pub fn create(file: W) -> Result<Self, RecordingError> {
        let writer = WriteOptions::new().profile("ros2").library("waypost").create(file)?;
        Ok(Self { writer, schemas: HashMap::new(), channels: HashMap::new() })
    }

    /// Adds a message of a topic, as in `/tf`, at a time since the robot's epoch.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn write<M: Message>(
        &mut self,
        topic: &str,
        stamp_ns: i64,
        message: &M,
    ) -> Result<(), RecordingError> {
        let schema = match self.schemas.get(M::TYPE) {
            Some(schema) => *schema,
            None => {
                let schema = self.writer.add_schema(M::TYPE, "ros2msg", definition(M::TYPE).as_bytes())?;
                self.schemas.insert(M::TYPE, schema);
                schema
            }
        };
        let (channel, sequence) = match self.channels.get(topic) {
            Some(known) => *known,
            None => (self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new())?, 0),
        };
        self.channels.insert(topic.to_owned(), (channel, sequence + 1));
        let data = encoded(message)?;
        let time = u64::try_from(stamp_ns).unwrap_or(0);
        let header = MessageHeader { channel_id: channel, sequence, log_time: time, publish_time: time };
        Ok(self.writer.write_to_known_channel(&header, &data)?)
    }

    /// Ends the recording, and gives its file back.
    ///
    /// # Errors
    /// [`RecordingError::File`].
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::messages::{Float64, Header, Path};

    #[test]
    fn what_is_written_is_read_again() {
        let mut recording = Recording::create(Cursor::new(Vec::new())).unwrap();
        let path = Path { header: Header::new(5, "map"), poses: Vec::new() };
        recording.write("/path", 5, &path).unwrap();
        for (stamp_ns, data) in [(6, 0.25), (7, 0.5)] {
            recording.write("/sure", stamp_ns, &Float64 { data }).unwrap();
        }
        let file = recording.finish().unwrap().into_inner();
        let messages: Vec<mcap::Message<'_>> =
            mcap::MessageStream::new(&file).unwrap().collect::<Result<_, _>>().unwrap();
        let told: Vec<(&str, &str, u64, u32)> = messages
            .iter()
            .map(|message| {
                let schema = message.channel.schema.as_ref().unwrap();
                (message.channel.topic.as_str(), schema.name.as_str(), message.log_time, message.sequence)
            })
            .collect();
        assert_eq!(
            told,
            [
                ("/path", "nav_msgs/msg/Path", 5, 0),
                ("/sure", "std_msgs/msg/Float64", 6, 0),
                ("/sure", "std_msgs/msg/Float64", 7, 1)
            ]
        );
        assert_eq!(messages[1].data[..], [&[0, 1, 0, 0][..], &0.25f64.to_le_bytes()].concat());
    }
}
