//! MCAP, by the crate of its makers.

use std::collections::{BTreeMap, HashMap};
use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};

use super::Message;
use super::messages::{Order, cdr};

/// In small chunks, so that there are several.
pub fn mcap(messages: &[Message], compression: Option<Compression>, order: Order) -> Vec<u8> {
    let options = WriteOptions::new().compression(compression).chunk_size(Some(512));
    let mut file = Cursor::new(Vec::new());
    let mut writer = options.create(&mut file).unwrap();
    let mut channels = HashMap::new();
    for (number, message) in (0..).zip(messages) {
        let channel_id = *channels.entry((message.topic, message.type_name)).or_insert_with(|| {
            let schema = writer.add_schema(&message.ros2_type(), "ros2msg", b"# not read").unwrap();
            writer.add_channel(schema, message.topic, "cdr", &BTreeMap::new()).unwrap()
        });
        let (log_time, publish_time) = (message.log_ns, message.log_ns);
        let header = MessageHeader { channel_id, sequence: number, log_time, publish_time };
        writer.write_to_known_channel(&header, &cdr(&message.fields, order)).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}
