//! ROS 1 bags of version 2.0, read from their start to their end, so that a missing index is not missed.
//!
//! The format: <http://wiki.ros.org/Bags/Format/2.0>.

use std::collections::HashMap;
use std::io::Read;
use std::ops::ControlFlow;

use super::compression::{ChunkSizes, read_chunk};
use super::{Body, Channel, RawMessage, Visit};
use crate::bytes::{Encoding, Reader};
use crate::error::BagError;
use crate::input::{Fault, Input, MOST_MESSAGE_BYTES, read_bytes, read_some, skip_bytes};

const MAGIC: [u8; 13] = *b"#ROSBAG V2.0\n";

const MESSAGE: u8 = 0x02;
const BAG_HEADER: u8 = 0x03;
const CHUNK: u8 = 0x05;
const CONNECTION: u8 = 0x07;

/// The longest head of a record, and the longest description of a connection.
const MOST_HEAD_BYTES: u32 = 1 << 20;
const MOST_DESCRIPTION_BYTES: u64 = 16 << 20;

/// Reads a file; `at_byte` is kept at the record that is being read.
pub(super) fn read(input: &mut Input<'_, '_>, at_byte: &mut u64, visit: &mut Visit<'_>) -> Result<(), Fault> {
    let (size, magic) = read_some(input)?;
    if size < MAGIC.len() || magic != MAGIC {
        let reason =
            "it does not begin as a ROS 1 bag of version 2.0 does; for older ones there is `rosbag migrate`"
                .to_owned();
        return Err(BagError::NotABag { path: input.path().to_owned(), reason }.into());
    }
    let mut known = Known::default();
    let mut index_at = 0;
    loop {
        *at_byte = input.position();
        let Some((head, size)) = record_head(input)? else {
            // A bag that was closed has its index where its header says, at the end.
            return if input.position() > index_at { Ok(()) } else { Err(Fault::Ended) };
        };
        let flow = match head.opcode()? {
            CHUNK => chunk(input, &head, size, &mut known, visit)?,
            BAG_HEADER => {
                index_at = head.number("index_pos")?;
                skip_bytes(input, size)?;
                ControlFlow::Continue(())
            }
            _ => known.record(input, &head, size, visit)?,
        };
        if flow.is_break() {
            return Ok(());
        }
    }
}

/// The fields of a record's head, by their names.
struct Head(Vec<u8>);

impl Head {
    fn field(&self, name: &str) -> Result<Option<&[u8]>, Fault> {
        let mut fields = Reader::packed(&self.0);
        while !fields.is_at_end() {
            let field = fields.bytes()?;
            let Some(equals) = field.iter().position(|byte| *byte == b'=') else {
                return Err(Fault::Wrong("a field of a record's head has no value".to_owned()));
            };
            if &field[..equals] == name.as_bytes() {
                return Ok(Some(&field[equals + 1..]));
            }
        }
        Ok(None)
    }

    fn needed(&self, name: &str) -> Result<&[u8], Fault> {
        self.field(name)?.ok_or_else(|| Fault::Wrong(format!("a record's head has no field {name}")))
    }

    /// A number of 1 to 8 bytes.
    fn number(&self, name: &str) -> Result<u64, Fault> {
        let bytes = self.needed(name)?;
        let mut number = [0; 8];
        number
            .get_mut(..bytes.len())
            .ok_or_else(|| Fault::Wrong(format!("the field {name} of a record's head is no number")))?
            .copy_from_slice(bytes);
        Ok(u64::from_le_bytes(number))
    }

    fn opcode(&self) -> Result<u8, Fault> {
        Ok(self.number("op")?.to_le_bytes()[0])
    }

    /// The time of a message: seconds in the lower half, nanoseconds in the upper.
    fn time_ns(&self) -> Result<i64, Fault> {
        let time = self.number("time")?;
        let (seconds, nanoseconds) = (time & u64::from(u32::MAX), time >> 32);
        Ok(seconds as i64 * 1_000_000_000 + nanoseconds as i64)
    }
}

/// A record's head and the length of its data; none at the end.
fn record_head(reader: &mut dyn Read) -> Result<Option<(Head, u64)>, Fault> {
    let (size, length) = read_some::<4>(reader)?;
    match size {
        0 => return Ok(None),
        4 => {}
        _ => return Err(Fault::Ended),
    }
    let length = u32::from_le_bytes(length);
    if length > MOST_HEAD_BYTES {
        return Err(Fault::Wrong(format!("the head of a record says it has {length} bytes")));
    }
    let mut head = Vec::new();
    read_bytes(reader, u64::from(length), &mut head)?;
    match read_some::<4>(reader)? {
        (4, size) => Ok(Some((Head(head), u64::from(u32::from_le_bytes(size))))),
        (_, _) => Err(Fault::Ended),
    }
}

fn chunk(
    input: &mut Input<'_, '_>,
    head: &Head,
    size: u64,
    known: &mut Known,
    visit: &mut Visit<'_>,
) -> Result<ControlFlow<()>, Fault> {
    let compression = String::from_utf8_lossy(head.needed("compression")?).into_owned();
    let sizes = ChunkSizes { stored_bytes: size, plain_bytes: head.number("size")?, crc: None };
    read_chunk(input, &compression, &sizes, &mut |records| {
        let Some((head, size)) = record_head(records)? else { return Ok(None) };
        known.record(records, &head, size, visit).map(Some)
    })
}

/// What the records so far say of those that come.
#[derive(Default)]
struct Known {
    connections: HashMap<u64, Channel>,
    buffer: Vec<u8>,
}

impl Known {
    fn record(
        &mut self,
        reader: &mut dyn Read,
        head: &Head,
        size: u64,
        visit: &mut Visit<'_>,
    ) -> Result<ControlFlow<()>, Fault> {
        match head.opcode()? {
            MESSAGE => self.message(reader, head, size, visit),
            CONNECTION => self.connection(reader, head, size).map(ControlFlow::Continue),
            CHUNK => Err(Fault::Wrong("a chunk has a chunk in it".to_owned())),
            // Indices, which reading everything does not need.
            _ => skip_bytes(reader, size).map(ControlFlow::Continue),
        }
    }

    fn connection(&mut self, reader: &mut dyn Read, head: &Head, size: u64) -> Result<(), Fault> {
        if size > MOST_DESCRIPTION_BYTES {
            return Err(Fault::Wrong(format!("the description of a connection has {size} bytes")));
        }
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let id = head.number("conn")?;
        let topic = text(head.needed("topic")?);
        let mut description = Vec::new();
        read_bytes(reader, size, &mut description)?;
        let type_name = text(Head(description).field("type")?.unwrap_or_default());
        self.connections.insert(id, Channel { topic, type_name, encoding: Encoding::Ros1 });
        Ok(())
    }

    fn message(
        &mut self,
        reader: &mut dyn Read,
        head: &Head,
        size: u64,
        visit: &mut Visit<'_>,
    ) -> Result<ControlFlow<()>, Fault> {
        let id = head.number("conn")?;
        let log_ns = head.time_ns()?;
        let channel = self.connections.get(&id).ok_or_else(|| {
            Fault::Wrong(format!("a message is of connection {id}, which nothing describes"))
        })?;
        let body = if size > MOST_MESSAGE_BYTES {
            skip_bytes(reader, size)?;
            Body::TooLong(size)
        } else {
            read_bytes(reader, size, &mut self.buffer)?;
            Body::Whole(&self.buffer)
        };
        Ok(visit(&RawMessage { channel, log_ns, body })?)
    }
}
