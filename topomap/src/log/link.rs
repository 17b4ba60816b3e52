//! How places are linked, and the bytes of that.

use fabmap::appearance::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};
use nalgebra::Isometry3;

use crate::metric::{RelativePose, decode_pose, encode_pose};

/// A way from one place to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Where it starts.
    pub from: PlaceId,
    /// Where it ends.
    pub to: PlaceId,
    /// What is known of it.
    pub kind: LinkKind,
}

/// How two places are linked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LinkKind {
    /// A session went from one to the other.
    Session,
    /// It did, and odometry measured the way: the pose of `to`'s frame in `from`'s. Logs before
    /// version 3 have these, without covariances.
    Odometry(Isometry3<f64>),
    /// A session drove from one to the other, and odometry measured the way: the pose of `to` in
    /// the frame of `from`.
    Driven(RelativePose),
    /// A session drove there and recognised where it was: the same, by odometry and what the
    /// closure, or the robot itself, measured.
    Closed(RelativePose),
}

impl Link {
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Link { from, to, kind } = self;
        writer.u32(from.number());
        writer.u32(to.number());
        match kind {
            LinkKind::Session => writer.u8(0),
            LinkKind::Odometry(relative) => {
                writer.u8(1);
                encode_pose(relative, writer);
            }
            LinkKind::Driven(measured) => {
                writer.u8(2);
                measured.encode(writer);
            }
            LinkKind::Closed(measured) => {
                writer.u8(3);
                measured.encode(writer);
            }
        }
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Link {
            from: PlaceId::new(reader.u32()?),
            to: PlaceId::new(reader.u32()?),
            kind: match reader.u8()? {
                0 => LinkKind::Session,
                1 => LinkKind::Odometry(decode_pose(reader)?),
                2 => LinkKind::Driven(RelativePose::decode(reader)?),
                3 => LinkKind::Closed(RelativePose::decode(reader)?),
                other => return Err(DecodeError::invalid(format_args!("link kind {other}"))),
            },
        })
    }
}
