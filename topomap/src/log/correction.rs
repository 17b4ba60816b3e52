//! What people say of loop closures, and the bytes of that.

use fabmap::appearance::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};

use super::link::Link;
use crate::bytes::{decode_option, encode_option};
use crate::ids::{FrameId, SessionId};
use crate::metric::{Odometry, RelativePose};

/// What a person said of a loop closure, with all that follows from it.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectionEvent {
    /// Position in the log.
    pub position: u64,
    /// The session of the frame that it is about.
    pub session: SessionId,
    /// Who said so; empty if nobody asked for a name.
    pub by: String,
    /// When, in nanoseconds since 1970.
    pub said_ns: i64,
    /// What was said.
    pub correction: Correction,
}

/// What a person said.
#[derive(Clone, Debug, PartialEq)]
pub enum Correction {
    /// A frame is not at the place that it closed a loop with.
    Withdrawn(Box<Withdrawal>),
    /// Two frames are at one place that the map has as two.
    Confirmed(Confirmation),
    /// An earlier correction was wrong: the map is as if it had not been made.
    Undone(Undoing),
}

/// A loop closure that is none.
#[derive(Clone, Debug, PartialEq)]
pub struct Withdrawal {
    /// The frame that closed the loop.
    pub frame: FrameId,
    /// The frame that it matched.
    pub earlier: FrameId,
    /// The place of both, until now.
    pub place: PlaceId,
    /// The frames that are at no place from now on, ascending: the one that closed the loop, and
    /// those after it that the session was at the place by its wheels alone.
    pub frames: Vec<FrameId>,
    /// Links that are others now.
    pub relinked: Vec<Relinked>,
    /// Where the session's next frame goes on from, if the session was at the place still.
    pub resumed: Option<Resumed>,
}

/// A link that rested on a loop closure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relinked {
    /// Position of the event that added it, or that came to its place without adding one.
    pub event: u64,
    /// The link until now; `None` if there was none.
    pub was: Option<Link>,
    /// And from now on: the way there from where the session surely was before.
    pub now: Option<Link>,
}

/// Where a session is, without the places that it was not at.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Resumed {
    /// The last place that it was at.
    pub stay: Option<Stood>,
    /// The last that it was surely at, with odometry and pose.
    pub anchor: Option<Stood>,
}

/// Where a frame was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Stood {
    /// The place.
    pub place: PlaceId,
    /// Odometry of the frame.
    pub odometry: Option<Odometry>,
    /// Where in the place's frame the robot was.
    pub at: Option<RelativePose>,
}

/// Two frames that are at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Confirmation {
    /// The later frame.
    pub frame: FrameId,
    /// The earlier one.
    pub earlier: FrameId,
    /// The link from the later frame's place to the earlier one's; `None` where those have become
    /// one since.
    pub link: Option<Link>,
}

/// A correction that is taken back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Undoing {
    /// Its position.
    pub correction: u64,
    /// The place that gets its frames back; `None` if none had lost any.
    pub place: Option<PlaceId>,
}

const WITHDRAWN: u8 = 0;
const CONFIRMED: u8 = 1;
const UNDONE: u8 = 2;

/// Least bytes of a [`Relinked`].
const RELINKED_BYTES: usize = 10;

impl CorrectionEvent {
    /// The place whose frames it changes; `None` if it changes none's.
    #[must_use]
    pub fn place(&self) -> Option<PlaceId> {
        match &self.correction {
            Correction::Withdrawn(withdrawal) => Some(withdrawal.place),
            Correction::Confirmed(_) => None,
            Correction::Undone(undoing) => undoing.place,
        }
    }

    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Self { position, session, by, said_ns, correction } = self;
        writer.u64(*position);
        writer.u32(*session);
        writer.str(by);
        writer.i64(*said_ns);
        match correction {
            Correction::Withdrawn(withdrawal) => {
                writer.u8(WITHDRAWN);
                withdrawal.encode(writer);
            }
            Correction::Confirmed(Confirmation { frame, earlier, link }) => {
                writer.u8(CONFIRMED);
                writer.u64(*frame);
                writer.u64(*earlier);
                encode_option(link.as_ref(), writer, Link::encode);
            }
            Correction::Undone(Undoing { correction, place }) => {
                writer.u8(UNDONE);
                writer.u64(*correction);
                encode_option(place.as_ref(), writer, |place, writer| writer.u32(place.number()));
            }
        }
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            position: reader.u64()?,
            session: reader.u32()?,
            by: reader.str()?.to_owned(),
            said_ns: reader.i64()?,
            correction: match reader.u8()? {
                WITHDRAWN => Correction::Withdrawn(Box::new(Withdrawal::decode(reader)?)),
                CONFIRMED => Correction::Confirmed(Confirmation {
                    frame: reader.u64()?,
                    earlier: reader.u64()?,
                    link: decode_option(reader, Link::decode)?,
                }),
                UNDONE => Correction::Undone(Undoing {
                    correction: reader.u64()?,
                    place: decode_option(reader, Reader::u32)?.map(PlaceId::new),
                }),
                other => return Err(DecodeError::invalid(format_args!("correction kind {other}"))),
            },
        })
    }
}

impl Withdrawal {
    /// Whether a frame is at no place by it.
    #[must_use]
    pub fn has(&self, frame: FrameId) -> bool {
        self.frames.binary_search(&frame).is_ok()
    }

    /// All places that it names.
    pub(crate) fn places(&self) -> Vec<PlaceId> {
        let links = self.relinked.iter().flat_map(|relinked| [relinked.was, relinked.now]).flatten();
        let Resumed { stay, anchor } = self.resumed.clone().unwrap_or_default();
        let stood = [stay, anchor].into_iter().flatten().map(|stood| stood.place);
        links.flat_map(|link| [link.from, link.to]).chain(stood).chain([self.place]).collect()
    }

    /// All positions of the log that it names.
    pub(crate) fn events(&self) -> Vec<u64> {
        let relinked = self.relinked.iter().map(|relinked| relinked.event);
        relinked.chain(self.frames.iter().copied()).chain([self.frame, self.earlier]).collect()
    }

    fn encode(&self, writer: &mut Writer) {
        let Self { frame, earlier, place, frames, relinked, resumed } = self;
        writer.u64(*frame);
        writer.u64(*earlier);
        writer.u32(place.number());
        writer.varint(frames.len() as u64);
        frames.iter().for_each(|frame| writer.u64(*frame));
        writer.varint(relinked.len() as u64);
        for Relinked { event, was, now } in relinked {
            writer.u64(*event);
            encode_option(was.as_ref(), writer, Link::encode);
            encode_option(now.as_ref(), writer, Link::encode);
        }
        encode_option(resumed.as_ref(), writer, |Resumed { stay, anchor }, writer| {
            encode_option(stay.as_ref(), writer, Stood::encode);
            encode_option(anchor.as_ref(), writer, Stood::encode);
        });
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            frame: reader.u64()?,
            earlier: reader.u64()?,
            place: PlaceId::new(reader.u32()?),
            frames: (0..reader.count(size_of::<u64>())?).map(|_| reader.u64()).collect::<Result<_, _>>()?,
            relinked: (0..reader.count(RELINKED_BYTES)?)
                .map(|_| {
                    Ok(Relinked {
                        event: reader.u64()?,
                        was: decode_option(reader, Link::decode)?,
                        now: decode_option(reader, Link::decode)?,
                    })
                })
                .collect::<Result<_, DecodeError>>()?,
            resumed: decode_option(reader, |reader| {
                Ok(Resumed {
                    stay: decode_option(reader, Stood::decode)?,
                    anchor: decode_option(reader, Stood::decode)?,
                })
            })?,
        })
    }
}

impl Stood {
    fn encode(&self, writer: &mut Writer) {
        let Self { place, odometry, at } = self;
        writer.u32(place.number());
        encode_option(odometry.as_ref(), writer, Odometry::encode);
        encode_option(at.as_ref(), writer, RelativePose::encode);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            place: PlaceId::new(reader.u32()?),
            odometry: decode_option(reader, Odometry::decode)?,
            at: decode_option(reader, RelativePose::decode)?,
        })
    }
}
