//! ROS 1 bags: chunks of connections and messages. The index behind them is left out, or said to be there.

use std::io::Write;

use super::Message;
use super::messages::ros1;

/// Compressions of chunks.
#[derive(Clone, Copy)]
pub enum Chunks {
    None,
    Bz2,
    Lz4,
}

impl Chunks {
    fn name(self) -> &'static [u8] {
        match self {
            Chunks::None => b"none",
            Chunks::Bz2 => b"bz2",
            Chunks::Lz4 => b"lz4",
        }
    }

    fn compress(self, bytes: &[u8]) -> Vec<u8> {
        match self {
            Chunks::None => bytes.to_vec(),
            Chunks::Bz2 => {
                let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
            Chunks::Lz4 => {
                let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
        }
    }
}

pub fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut head = Vec::new();
    for (name, value) in fields {
        head.extend((name.len() as u32 + 1 + value.len() as u32).to_le_bytes());
        head.extend(name.as_bytes());
        head.push(b'=');
        head.extend(*value);
    }
    let mut record = (head.len() as u32).to_le_bytes().to_vec();
    record.extend(head);
    record.extend((data.len() as u32).to_le_bytes());
    record.extend(data);
    record
}

fn inner_records(messages: &[Message], first: &[&str]) -> Vec<u8> {
    let mut records = Vec::new();
    for message in messages {
        let connection = first.iter().position(|topic| *topic == message.topic).unwrap() as u32;
        let id = connection.to_le_bytes();
        let described =
            record(&[("topic", message.topic.as_bytes()), ("type", message.type_name.as_bytes())], &[]);
        // The head of that record, without its two lengths, is what a connection's data looks like.
        let data = &described[4..described.len() - 4];
        records.extend(record(&[("op", &[7]), ("conn", &id), ("topic", message.topic.as_bytes())], data));
        let (seconds, nanoseconds) = (message.log_ns / 1_000_000_000, message.log_ns % 1_000_000_000);
        let time = (nanoseconds << 32 | seconds).to_le_bytes();
        records.extend(record(&[("op", &[2]), ("conn", &id), ("time", &time)], &ros1(&message.fields)));
    }
    records
}

/// A chunk that says what it is told to say of its length.
pub fn chunk(records: &[u8], chunks: Chunks, said_bytes: u32) -> Vec<u8> {
    let fields: [(&str, &[u8]); 3] =
        [("op", &[5]), ("compression", chunks.name()), ("size", &said_bytes.to_le_bytes())];
    record(&fields, &chunks.compress(records))
}

pub fn bag_header(index_at: u64) -> Vec<u8> {
    let mut file = b"#ROSBAG V2.0\n".to_vec();
    let fields: [(&str, &[u8]); 4] = [
        ("op", &[3]),
        ("index_pos", &index_at.to_le_bytes()),
        ("conn_count", &[0; 4]),
        ("chunk_count", &[0; 4]),
    ];
    file.extend(record(&fields, &[b' '; 64]));
    file
}

/// Three messages in a chunk, and no index, as of a bag that was not closed.
pub fn ros1_bag(messages: &[Message], chunks: Chunks) -> Vec<u8> {
    let mut topics: Vec<&str> = messages.iter().map(|message| message.topic).collect();
    topics.dedup();
    let mut file = bag_header(0);
    for some in messages.chunks(3) {
        let records = inner_records(some, &topics);
        file.extend(chunk(&records, chunks, records.len() as u32));
    }
    file
}
