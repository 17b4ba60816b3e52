//! MCAP, read from its start to its end: neither index nor summary are needed.
//!
//! Records are read here, and not by the `mcap` crate, for what it cannot do: say at which byte a file is damaged, and
//! read a chunk of any length without having it whole in memory. The format: <https://mcap.dev/spec>.

use std::collections::HashMap;
use std::io::Read;
use std::ops::ControlFlow;

use super::compression::{ChunkSizes, read_chunk};
use super::{Body, Channel, RawMessage, Visit};
use crate::bytes::{Encoding, Reader};
use crate::error::BagError;
use crate::input::{Fault, Input, MOST_MESSAGE_BYTES, read_bytes, read_some, skip_bytes};

const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const DATA_END: u8 = 0x0f;

/// A record's type and length.
const RECORD_HEAD_BYTES: usize = 9;
/// Channel, number, time of recording and time of sending.
const MESSAGE_HEAD_BYTES: usize = 22;
/// Times, size, CRC, and the length of the compression's name.
const CHUNK_HEAD_BYTES: usize = 32;
/// The longest description of a type or a channel.
const MOST_DESCRIPTION_BYTES: u64 = 16 << 20;
const MOST_NAME_BYTES: u64 = 256;

/// Reads a file; `at_byte` is kept at the record that is being read.
pub(super) fn read(input: &mut Input<'_, '_>, at_byte: &mut u64, visit: &mut Visit<'_>) -> Result<(), Fault> {
    let (size, magic) = read_some(input)?;
    if size < MAGIC.len() || magic != MAGIC {
        let reason = "it does not begin as MCAP does; check the file, or record it anew".to_owned();
        return Err(BagError::NotABag { path: input.path().to_owned(), reason }.into());
    }
    let mut known = Known::default();
    loop {
        *at_byte = input.position();
        let crc_so_far = input.crc();
        // Without an end of data the file was cut off, even between two records.
        let (opcode, size) = record_head(input)?.ok_or(Fault::Ended)?;
        let flow = match opcode {
            CHUNK => chunk(input, size, &mut known, visit)?,
            DATA_END => return check_data(input, size, crc_so_far),
            _ => known.record(input, opcode, size, visit)?,
        };
        if flow.is_break() {
            return Ok(());
        }
    }
}

fn record_head(reader: &mut dyn Read) -> Result<Option<(u8, u64)>, Fault> {
    let (size, head) = read_some::<RECORD_HEAD_BYTES>(reader)?;
    let mut fields = Reader::packed(&head);
    match size {
        0 => Ok(None),
        RECORD_HEAD_BYTES => Ok(Some((fields.u8()?, fields.u64()?))),
        _ => Err(Fault::Ended),
    }
}

fn check_data(input: &mut Input<'_, '_>, size: u64, computed: u32) -> Result<(), Fault> {
    let mut record = Vec::new();
    read_bytes(input, size.min(MOST_DESCRIPTION_BYTES), &mut record)?;
    match Reader::packed(&record).u32()? {
        0 => Ok(()),
        crc if crc == computed => Ok(()),
        crc => Err(Fault::Wrong(format!(
            "the CRC of all data is {crc:08x}, and that of the bytes before {computed:08x}"
        ))),
    }
}

fn chunk(
    input: &mut Input<'_, '_>,
    size: u64,
    known: &mut Known,
    visit: &mut Visit<'_>,
) -> Result<ControlFlow<()>, Fault> {
    let mut head = Vec::new();
    read_bytes(input, CHUNK_HEAD_BYTES as u64, &mut head)?;
    let mut fields = Reader::packed(&head);
    let [_first_ns, _last_ns, plain_bytes] = [fields.u64()?, fields.u64()?, fields.u64()?];
    let crc = fields.u32()?;
    let name_bytes = u64::from(fields.u32()?);
    let before_records = CHUNK_HEAD_BYTES as u64 + name_bytes + 8;
    if name_bytes > MOST_NAME_BYTES || before_records > size {
        return Err(Fault::Wrong("a chunk's compression has a name that is too long".to_owned()));
    }
    read_bytes(input, name_bytes, &mut head)?;
    let compression = String::from_utf8_lossy(&head).into_owned();
    read_bytes(input, 8, &mut head)?;
    let stored_bytes = Reader::packed(&head).u64()?;
    if stored_bytes != size - before_records {
        return Err(Fault::Wrong(format!(
            "a chunk says it has {stored_bytes} bytes of records, and there is room for {}",
            size - before_records
        )));
    }
    let sizes = ChunkSizes { stored_bytes, plain_bytes, crc: (crc != 0).then_some(crc) };
    read_chunk(input, &compression, &sizes, &mut |records| {
        let Some((opcode, size)) = record_head(records)? else { return Ok(None) };
        if opcode == CHUNK || opcode == DATA_END {
            return Err(Fault::Wrong(format!("a chunk has a record of type {opcode:#04x}")));
        }
        known.record(records, opcode, size, visit).map(Some)
    })
}

/// What the records so far say of those that come.
#[derive(Default)]
struct Known {
    types: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    buffer: Vec<u8>,
}

impl Known {
    fn record(
        &mut self,
        reader: &mut dyn Read,
        opcode: u8,
        size: u64,
        visit: &mut Visit<'_>,
    ) -> Result<ControlFlow<()>, Fault> {
        match opcode {
            MESSAGE => return self.message(reader, size, visit),
            SCHEMA | CHANNEL if size > MOST_DESCRIPTION_BYTES => {
                return Err(Fault::Wrong(format!("the description of a channel has {size} bytes")));
            }
            SCHEMA => {
                read_bytes(reader, size, &mut self.buffer)?;
                let mut fields = Reader::packed(&self.buffer);
                self.types.insert(fields.u16()?, fields.text()?.to_owned());
            }
            CHANNEL => {
                read_bytes(reader, size, &mut self.buffer)?;
                let mut fields = Reader::packed(&self.buffer);
                let id = fields.u16()?;
                let schema = fields.u16()?;
                let topic = fields.text()?.to_owned();
                let encoding = match fields.text()? {
                    "cdr" => Encoding::Cdr,
                    "ros1" => Encoding::Ros1,
                    other => Encoding::Other(other.to_owned()),
                };
                let type_name = self.types.get(&schema).cloned().unwrap_or_default();
                self.channels.insert(id, Channel { topic, type_name, encoding });
            }
            0 => return Err(Fault::Wrong("a record has type 0, which there is not".to_owned())),
            _ => skip_bytes(reader, size)?,
        }
        Ok(ControlFlow::Continue(()))
    }

    fn message(
        &mut self,
        reader: &mut dyn Read,
        size: u64,
        visit: &mut Visit<'_>,
    ) -> Result<ControlFlow<()>, Fault> {
        let Some(size_bytes) = size.checked_sub(MESSAGE_HEAD_BYTES as u64) else {
            return Err(Fault::Wrong(format!("a message has {size} bytes, less than its head")));
        };
        read_bytes(reader, MESSAGE_HEAD_BYTES as u64, &mut self.buffer)?;
        let mut fields = Reader::packed(&self.buffer);
        let (channel, _number, log_ns) = (fields.u16()?, fields.u32()?, fields.u64()?);
        let channel = self.channels.get(&channel).ok_or_else(|| {
            Fault::Wrong(format!("a message is of channel {channel}, which nothing describes"))
        })?;
        let body = if size_bytes > MOST_MESSAGE_BYTES {
            skip_bytes(reader, size_bytes)?;
            Body::TooLong(size_bytes)
        } else {
            read_bytes(reader, size_bytes, &mut self.buffer)?;
            Body::Whole(&self.buffer)
        };
        let log_ns = i64::try_from(log_ns).unwrap_or(i64::MAX);
        Ok(visit(&RawMessage { channel, log_ns, body })?)
    }
}
