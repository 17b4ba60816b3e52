//! How programs tell ROS 2 which nodes they are: `rmw_dds_common/ParticipantEntitiesInfo`.

use serde::Serialize;

use crate::messages::{CdrError, laid_out};

/// What something is called in DDS: its program, and what it is there.
pub type Gid = [u8; 16];

/// The same up to Humble: eight zeros are behind it.
type LongGid = [u8; 24];

/// What ROS 2 names the message. It is not the same one up to Humble, though its name is.
pub const NODES: &str = "rmw_dds_common/msg/ParticipantEntitiesInfo";

/// Which ROS 2 reads a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Era {
    /// Humble, and those before.
    Humble,
    /// Iron, and those since.
    Iron,
}

impl Era {
    /// Of whoever wrote such a message, which is given behind its four bytes of encapsulation; none if it is cut off.
    #[must_use]
    pub fn of(message: &[u8]) -> Option<Self> {
        let body = message.get(4..)?;
        // Behind the 16 bytes are eight zeros, or the number of nodes and the first one's namespace. Without
        // any node a message of Iron ends there.
        match body.get(16..24) {
            Some(behind) if behind == [0; 8] => Some(Self::Humble),
            Some(_) => Some(Self::Iron),
            None => (body.len() >= 20).then_some(Self::Iron),
        }
    }
}

/// A program, and the nodes in it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Participant<G = Gid> {
    /// Of the program.
    pub gid: G,
    /// All of them.
    pub nodes: Vec<NodeEntities<G>>,
}

/// A node, and what it reads and writes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NodeEntities<G = Gid> {
    /// Begins with a slash.
    pub namespace: String,
    /// Without its namespace.
    pub name: String,
    /// Those that read topics, and requests or answers of services.
    pub readers: Vec<G>,
    /// Those that write them.
    pub writers: Vec<G>,
}

impl Participant {
    /// The message in CDR, without its bytes of encapsulation.
    ///
    /// # Errors
    /// If it has something that CDR cannot say.
    pub fn laid_out(&self, era: Era) -> Result<Vec<u8>, CdrError> {
        match era {
            Era::Iron => laid_out(self),
            Era::Humble => laid_out(&self.with_long_gids()),
        }
    }

    fn with_long_gids(&self) -> Participant<LongGid> {
        let all = |gids: &[Gid]| gids.iter().map(long).collect();
        let nodes =
            self.nodes.iter().map(|NodeEntities { namespace, name, readers, writers }| NodeEntities {
                namespace: namespace.clone(),
                name: name.clone(),
                readers: all(readers),
                writers: all(writers),
            });
        Participant { gid: long(&self.gid), nodes: nodes.collect() }
    }
}

fn long(gid: &Gid) -> LongGid {
    let mut long = [0; 24];
    long[..gid.len()].copy_from_slice(gid);
    long
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told() -> Participant {
        let node = NodeEntities {
            namespace: "/".to_owned(),
            name: "waypost".to_owned(),
            readers: vec![[3; 16]],
            writers: Vec::new(),
        };
        Participant { gid: [9; 16], nodes: vec![node] }
    }

    #[test]
    fn a_program_is_laid_out_as_each_ros_reads_it() {
        for (era, behind) in [(Era::Iron, &[][..]), (Era::Humble, &[0; 8])] {
            let expected = [
                &[9; 16][..],
                behind,
                &[1, 0, 0, 0],
                b"\x02\0\0\0/\0\0\0",
                b"\x08\0\0\0waypost\0",
                &[1, 0, 0, 0],
                &[3; 16],
                behind,
                &[0, 0, 0, 0],
            ];
            assert_eq!(told().laid_out(era).unwrap(), expected.concat(), "{era:?}");
        }
    }

    #[test]
    fn a_message_tells_of_which_ros_it_is() {
        for nodes in [Vec::new(), told().nodes] {
            for era in [Era::Iron, Era::Humble] {
                let message = Participant { nodes: nodes.clone(), ..told() }.laid_out(era).unwrap();
                assert_eq!(Era::of(&[&[0, 1, 0, 0], &message[..]].concat()), Some(era));
            }
        }
        for short in [0, 3, 20, 23] {
            assert_eq!(Era::of(&vec![1; short]), None);
        }
    }
}
