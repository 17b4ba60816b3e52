//! Byte forms of the map's parts: what the state hash covers, and what checkpoints keep.

use std::collections::VecDeque;

use fabmap::PlaceId;
use fabmap::appearance::Appearance;
use fabmap::codec::{Container, DecodeError, Reader, Writer};
use sha2::{Digest, Sha256};

use super::{
    Anchor, LeftPlace, Map, Measured, Milestone, Milestones, Past, Place, PlaceFrame, Placed, Session,
    Sighting, Stay,
};
use crate::bytes::{decode_belief, decode_option, encode_belief, encode_option, finite, not_negative};
use crate::evidence::LookAlikesSeen;
use crate::metric::{Odometry, RelativePose};
use crate::settings::MAX_PAST_FRAMES;
use posegraph::PlanarPose;

impl Map {
    /// Links, sessions and the number of events: all but the places, as the state hash covers them.
    pub(super) fn encode_graph(&self) -> Vec<u8> {
        let Self { places, links: _, linked: _, learnt: _, sessions, corrections, events } = self;
        let verified = sessions.values().any(|session| !session.sightings.is_empty());
        let posed = sessions.values().any(Session::is_posed);
        let measured = sessions.values().any(Session::is_measured);
        let version = match (measured, posed, verified) {
            _ if sessions.values().any(Session::knows_look_alikes) => SESSION_VERSION,
            (true, _, _) => BEFORE_LOOK_ALIKES,
            (false, true, _) => BEFORE_MILESTONES,
            (false, false, true) => BEFORE_POSES,
            (false, false, false) => BEFORE_VERIFICATION,
        };
        let mut writer = Writer::default();
        // Neither an undone correction nor its undoing has decided anything.
        writer.u64(events.saturating_sub(2 * self.undone_corrections()));
        writer.varint(places.len() as u64);
        writer.varint(self.standing_links().count() as u64);
        self.standing_links().for_each(|(_, link)| link.encode(&mut writer));
        writer.varint(sessions.len() as u64);
        for (id, session) in sessions {
            writer.u32(*id);
            session.encode(version, &mut writer);
        }
        corrections.encode_standing(&mut writer);
        Container { version, ..GRAPH }.seal(&writer.into_bytes())
    }
}

/// Version of a session's byte form; 2 added the sightings, 3 where the robot is in its place, 4 how
/// far it has come and where sightings put it, 5 what look-alikes show.
pub(crate) const SESSION_VERSION: u32 = 5;

/// The versions without. The graph of a map that has none of what was added is still hashed so: its
/// hash is what it was.
const BEFORE_LOOK_ALIKES: u32 = 4;
const BEFORE_MILESTONES: u32 = 3;
const BEFORE_POSES: u32 = 2;
const BEFORE_VERIFICATION: u32 = 1;

const GRAPH: Container =
    Container { magic: *b"WPGRAPH\n", name: "Waypost checkpoint", version: SESSION_VERSION };

impl Place {
    /// Appends the frames that the place learnt from.
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Self { frames } = self;
        writer.varint(frames.len() as u64);
        for PlaceFrame { frame, session, number } in frames {
            writer.varint(*frame);
            writer.varint(u64::from(*session));
            writer.varint(*number);
        }
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let count = reader.count(3)?;
        let frame = |_| {
            Ok(PlaceFrame {
                frame: reader.varint()?,
                session: reader.varint_u32()?,
                number: reader.varint()?,
            })
        };
        let frames = (0..count).map(frame).collect::<Result<_, DecodeError>>()?;
        Ok(Self { frames })
    }
}

/// Bytes of SHA-256 that each place carries: enough to notice damage.
const PLACE_CHECKSUM_BYTES: usize = 8;

/// A place with its appearance, as a checkpoint keeps it.
#[must_use]
pub fn encode_place(place: &Place, appearance: &Appearance) -> Vec<u8> {
    let mut writer = Writer::default();
    appearance.encode(&mut writer);
    place.encode(&mut writer);
    let mut bytes = writer.into_bytes();
    let checksum = Sha256::digest(&bytes);
    bytes.extend_from_slice(&checksum[..PLACE_CHECKSUM_BYTES]);
    bytes
}

/// Reads what [`encode_place`] wrote, for a vocabulary of `vocabulary_len` words.
///
/// # Errors
/// [`DecodeError`] if the bytes are no place.
pub fn decode_place(bytes: &[u8], vocabulary_len: usize) -> Result<(Place, Appearance), DecodeError> {
    let (content, checksum) = bytes
        .split_last_chunk::<PLACE_CHECKSUM_BYTES>()
        .ok_or(DecodeError::Truncated { needed: PLACE_CHECKSUM_BYTES.saturating_sub(bytes.len()) })?;
    if Sha256::digest(content)[..PLACE_CHECKSUM_BYTES] != checksum[..] {
        return Err(DecodeError::Checksum);
    }
    let mut reader = Reader::new(content);
    let appearance = Appearance::decode(&mut reader, vocabulary_len)?;
    let place = Place::decode(&mut reader)?;
    reader.end()?;
    Ok((place, appearance))
}

impl Session {
    /// Whether anything is known that the second version has no bytes for.
    fn is_posed(&self) -> bool {
        !self.past.is_empty() || self.stay.as_ref().is_some_and(|stay| stay.at.is_some())
    }

    /// Whether anything is known that the third version has no bytes for.
    fn is_measured(&self) -> bool {
        !self.milestones.passed.is_empty() || self.sightings.iter().any(|sighting| sighting.placed.is_some())
    }

    /// Whether anything is known that the fourth version has no bytes for.
    fn knows_look_alikes(&self) -> bool {
        self.look_alikes != LookAlikesSeen::default()
    }

    pub(crate) fn encode(&self, version: u32, writer: &mut Writer) {
        let Self {
            frames,
            last_sequence,
            last_stamp_ns,
            last_odometry,
            stay,
            left,
            belief,
            sightings,
            past,
            anchor,
            milestones,
            look_alikes: LookAlikesSeen { inliers, shares, frames: compared },
        } = self;
        writer.u64(*frames);
        encode_option(last_sequence.as_ref(), writer, |sequence, writer| writer.u64(*sequence));
        encode_option(last_stamp_ns.as_ref(), writer, |stamp_ns, writer| writer.i64(*stamp_ns));
        encode_option(last_odometry.as_ref(), writer, |(stamp_ns, odometry), writer| {
            writer.i64(*stamp_ns);
            odometry.encode(writer);
        });
        encode_option(stay.as_ref(), writer, |Stay { place, looks, odometry, at }, writer| {
            writer.u32(place.number());
            writer.u32(*looks);
            encode_option(odometry.as_ref(), writer, Odometry::encode);
            if version > BEFORE_POSES {
                encode_option(at.as_ref(), writer, RelativePose::encode);
            }
        });
        writer.varint(left.len() as u64);
        for &LeftPlace { place, number, looks } in left {
            writer.u32(place.number());
            writer.u64(number);
            writer.u32(looks);
        }
        encode_belief(belief, writer);
        if version > BEFORE_VERIFICATION {
            writer.varint(sightings.len() as u64);
            sightings.iter().for_each(|sighting| sighting.encode(version, writer));
        }
        if version > BEFORE_POSES {
            writer.varint(past.len() as u64);
            for Past { odometry, belief } in past {
                odometry.encode(writer);
                encode_belief(belief, writer);
            }
            encode_option(anchor.as_ref(), writer, |Anchor { place, odometry, at }, writer| {
                writer.u32(place.number());
                odometry.encode(writer);
                at.encode(writer);
            });
        }
        if version > BEFORE_MILESTONES {
            milestones.encode(writer);
        }
        if version > BEFORE_LOOK_ALIKES {
            encode_option(inliers.as_ref(), writer, |inliers, writer| writer.f64(*inliers));
            writer.f64(*shares);
            writer.u64(*compared);
        }
    }

    pub(crate) fn decode(version: u32, reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            frames: reader.u64()?,
            last_sequence: decode_option(reader, Reader::u64)?,
            last_stamp_ns: decode_option(reader, Reader::i64)?,
            last_odometry: decode_option(reader, |reader| Ok((reader.i64()?, Odometry::decode(reader)?)))?,
            stay: decode_option(reader, |reader| {
                Ok(Stay {
                    place: PlaceId::new(reader.u32()?),
                    looks: reader.u32()?,
                    odometry: decode_option(reader, Odometry::decode)?,
                    at: if version > BEFORE_POSES {
                        decode_option(reader, RelativePose::decode)?
                    } else {
                        None
                    },
                })
            })?,
            left: (0..reader.count(16)?)
                .map(|_| {
                    Ok(LeftPlace {
                        place: PlaceId::new(reader.u32()?),
                        number: reader.u64()?,
                        looks: reader.u32()?,
                    })
                })
                .collect::<Result<_, DecodeError>>()?,
            belief: decode_belief(reader)?,
            sightings: if version > BEFORE_VERIFICATION {
                (0..reader.count(SIGHTING_BYTES)?)
                    .map(|_| Sighting::decode(version, reader))
                    .collect::<Result<_, _>>()?
            } else {
                VecDeque::new()
            },
            past: if version > BEFORE_POSES { decode_past(reader)? } else { VecDeque::new() },
            anchor: if version > BEFORE_POSES { decode_option(reader, decode_anchor)? } else { None },
            milestones: if version > BEFORE_MILESTONES {
                Milestones::decode(reader)?
            } else {
                Milestones::default()
            },
            look_alikes: if version > BEFORE_LOOK_ALIKES {
                LookAlikesSeen {
                    inliers: decode_option(reader, |reader| not_negative(reader.f64()?))?,
                    shares: not_negative(reader.f64()?)?,
                    frames: reader.u64()?,
                }
            } else {
                LookAlikesSeen::default()
            },
        })
    }
}

fn decode_anchor(reader: &mut Reader<'_>) -> Result<Anchor, DecodeError> {
    Ok(Anchor {
        place: PlaceId::new(reader.u32()?),
        odometry: Odometry::decode(reader)?,
        at: RelativePose::decode(reader)?,
    })
}

fn decode_past(reader: &mut Reader<'_>) -> Result<VecDeque<Past>, DecodeError> {
    let frames = reader.varint()?;
    if frames > MAX_PAST_FRAMES as u64 {
        return Err(DecodeError::invalid(format_args!("{frames} frames to look back on")));
    }
    let past = |_| Ok(Past { odometry: Odometry::decode(reader)?, belief: decode_belief(reader)? });
    (0..frames).map(past).collect()
}

const BY_STRUCTURE: u8 = 0;
const BY_TWO_VIEWS: u8 = 1;

fn decode_placed(reader: &mut Reader<'_>) -> Result<Placed, DecodeError> {
    let at = RelativePose::decode(reader)?;
    let measured = match reader.u8()? {
        BY_STRUCTURE => Measured::ByStructure,
        BY_TWO_VIEWS => Measured::ByTwoViews,
        other => return Err(DecodeError::invalid(format_args!("measure {other}"))),
    };
    let mut value = || finite(reader.f64()?);
    Ok(Placed { at, measured, wheels: PlanarPose::new(value()?, value()?, value()?) })
}

/// Bytes of a milestone.
const MILESTONE_BYTES: usize = 16;

impl Milestones {
    fn encode(&self, writer: &mut Writer) {
        let Self { way_spacings, passed } = self;
        writer.f64(*way_spacings);
        writer.varint(passed.len() as u64);
        for Milestone { frame, way_spacings } in passed {
            writer.u64(*frame);
            writer.f64(*way_spacings);
        }
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let way_spacings = not_negative(reader.f64()?)?;
        let passed = (0..reader.count(MILESTONE_BYTES)?)
            .map(|_| Ok(Milestone { frame: reader.u64()?, way_spacings: not_negative(reader.f64()?)? }))
            .collect::<Result<_, DecodeError>>()?;
        Ok(Self { way_spacings, passed })
    }
}

/// Least bytes of a sighting.
const SIGHTING_BYTES: usize = 20;

impl Sighting {
    fn encode(&self, version: u32, writer: &mut Writer) {
        let Self {
            number,
            place,
            seen: PlaceFrame { frame, session, number: of_session },
            evidence,
            total_evidence,
            placed,
        } = self;
        for value in [*number, u64::from(*place), *frame, u64::from(*session), *of_session] {
            writer.varint(value);
        }
        writer.f64(*evidence);
        writer.f64(*total_evidence);
        if version > BEFORE_MILESTONES {
            encode_option(placed.as_ref(), writer, |Placed { at, measured, wheels }, writer| {
                at.encode(writer);
                writer.u8(match measured {
                    Measured::ByStructure => BY_STRUCTURE,
                    Measured::ByTwoViews => BY_TWO_VIEWS,
                });
                [wheels.x_m(), wheels.y_m(), wheels.heading_rad()]
                    .into_iter()
                    .for_each(|value| writer.f64(value));
            });
        }
    }

    fn decode(version: u32, reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            number: reader.varint()?,
            place: PlaceId::new(reader.varint_u32()?),
            seen: PlaceFrame {
                frame: reader.varint()?,
                session: reader.varint_u32()?,
                number: reader.varint()?,
            },
            evidence: not_negative(reader.f64()?)?,
            total_evidence: not_negative(reader.f64()?)?,
            placed: if version > BEFORE_MILESTONES { decode_option(reader, decode_placed)? } else { None },
        })
    }
}
