//! rosbag2's SQLite.

use std::path::Path;

use rusqlite::Connection;

use super::Message;
use super::messages::{Order, cdr};

/// How messages are stored.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    Plain,
    Zstd,
}

pub fn sqlite(path: &Path, messages: &[Message], stored: Stored) {
    let database = Connection::open(path).unwrap();
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
             serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL); \
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, \
             data BLOB NOT NULL)",
        )
        .unwrap();
    for message in messages {
        let id = 1 + messages.iter().position(|other| other.topic == message.topic).unwrap() as i64;
        database
            .execute(
                "INSERT OR IGNORE INTO topics VALUES (?1, ?2, ?3, 'cdr', '')",
                (id, message.topic, message.ros2_type()),
            )
            .unwrap();
        let mut data = cdr(&message.fields, Order::Little);
        if stored == Stored::Zstd {
            data = zstd::encode_all(data.as_slice(), 3).unwrap();
        }
        database
            .execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)",
                (id, message.log_ns as i64, data),
            )
            .unwrap();
    }
}
