//! The bridge among the nodes of ROS: `ros2 node list` and `ros2 node info` ask who is there.
//!
//! The message about it is another one up to Humble, by the same name, and nobody says which ROS it
//! is. So the bridge tells nothing until somebody else has, and then speaks as that one does.

use std::sync::{Mutex, PoisonError};

use futures::StreamExt;
use rustdds::{GUID, WriteOptions};
use waypost_ros_messages::{Era, Gid, NodeEntities, Participant};

use crate::raw::{Incoming, RawWriter};

/// Where programs tell which nodes they are; its name has nothing before it, as those of topics have.
pub(crate) const TOPIC: &str = "ros_discovery_info";

/// The bridge's name among them; its parameters are those of a node of this name.
const NAME: &str = "waypost";

/// What the bridge reads and writes, as it comes to be.
#[derive(Default)]
pub(crate) struct Entities(Mutex<ReadersAndWriters>);

#[derive(Default)]
struct ReadersAndWriters {
    readers: Vec<Gid>,
    writers: Vec<Gid>,
}

impl Entities {
    pub(crate) fn add_reader(&self, reader: GUID) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).readers.push(reader.to_bytes());
    }

    pub(crate) fn add_writer(&self, writer: GUID) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).writers.push(writer.to_bytes());
    }

    /// The bridge as a node in a namespace without slashes around it.
    pub(crate) fn of_node(&self, namespace: &str) -> NodeEntities {
        let ReadersAndWriters { readers, writers } = &*self.0.lock().unwrap_or_else(PoisonError::into_inner);
        NodeEntities {
            namespace: format!("/{namespace}"),
            name: NAME.to_owned(),
            readers: readers.clone(),
            writers: writers.clone(),
        }
    }
}

/// That the bridge is a node.
pub(crate) struct Presence {
    /// What others tell.
    pub(crate) others: Incoming,
    /// Whoever comes late is told, as long as this is there.
    pub(crate) writer: RawWriter,
    pub(crate) bridge: Participant,
}

impl Presence {
    /// Tells it to those who tell of themselves, as they do.
    pub(crate) async fn tell(mut self) {
        let mut told = None;
        while let Some(message) = self.others.next().await {
            let era = Era::of(&message);
            let is_own = message.get(4..20) == Some(&self.bridge.gid[..]);
            if let (Some(era), false, true) = (era, is_own, era != told) {
                told = Some(era);
                match self.bridge.laid_out(era) {
                    Ok(body) => drop(self.writer.write(body, WriteOptions::default())),
                    Err(error) => tracing::warn!("`ros2 node list` does not show the bridge: {error}"),
                }
            }
        }
    }
}
