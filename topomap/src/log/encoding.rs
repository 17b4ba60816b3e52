//! The byte form of events, version by version.

use fabmap::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};
use fabmap::observation::Observation;

use super::correction::CorrectionEvent;
use super::event::{Decision, FrameEvent, MapEvent, MeasuredEvent, Reason};
use super::link::Link;
use crate::bytes::{decode_belief, decode_flag, decode_option, encode_belief, encode_option, not_negative};
use crate::evidence::{Candidate, CandidateForm, Match, VerificationSettings};
use crate::metric::{Odometry, RelativePose};

/// Version of the byte form of [`MapEvent`]; 2 added the candidates, 3 where in its place the robot
/// is, 4 what robots measured by themselves, 5 where structure puts the robot, 6 how probable
/// candidates are beside look-alikes, 7 what people correct. All but corrections are written as
/// before those.
const VERSION: u8 = 7;
const VERSION_BEFORE_CORRECTIONS: u8 = 6;
const VERSION_BEFORE_PROBABILITY: u8 = 5;
const VERSION_BEFORE_PLACEMENT: u8 = 4;
const VERSION_BEFORE_POSES: u8 = 2;
const VERSION_BEFORE_VERIFICATION: u8 = 1;
const SESSION_OPENED: u8 = 0;
const FRAME: u8 = 1;
const MEASURED: u8 = 2;
const CORRECTED: u8 = 3;

impl MapEvent {
    /// The byte form that the log keeps.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.u8(match self {
            MapEvent::SessionOpened { .. } | MapEvent::Frame(_) | MapEvent::Measured(_) => {
                VERSION_BEFORE_CORRECTIONS
            }
            MapEvent::Corrected(_) => VERSION,
        });
        match self {
            MapEvent::SessionOpened { session } => {
                writer.u8(SESSION_OPENED);
                writer.u32(*session);
            }
            MapEvent::Frame(event) => {
                writer.u8(FRAME);
                encode_frame(event, &mut writer);
            }
            MapEvent::Measured(event) => {
                writer.u8(MEASURED);
                event.encode(&mut writer);
            }
            MapEvent::Corrected(event) => {
                writer.u8(CORRECTED);
                event.encode(&mut writer);
            }
        }
        writer.into_bytes()
    }

    /// Reads what [`MapEvent::to_bytes`] wrote, for a map over a vocabulary of `vocabulary_len`
    /// words.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut, newer than this program or hold no event.
    pub fn from_bytes(bytes: &[u8], vocabulary_len: usize) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(bytes);
        let version = reader.u8()?;
        if !(VERSION_BEFORE_VERIFICATION..=VERSION).contains(&version) {
            return Err(DecodeError::Version { found: version.into(), newest: VERSION.into() });
        }
        let event = match reader.u8()? {
            SESSION_OPENED => MapEvent::SessionOpened { session: reader.u32()? },
            FRAME => MapEvent::Frame(Box::new(decode_frame(version, &mut reader, vocabulary_len)?)),
            MEASURED => MapEvent::Measured(Box::new(MeasuredEvent::decode(&mut reader)?)),
            CORRECTED => MapEvent::Corrected(Box::new(CorrectionEvent::decode(&mut reader)?)),
            other => return Err(DecodeError::invalid(format_args!("event kind {other}"))),
        };
        reader.end()?;
        Ok(event)
    }
}

fn encode_frame(event: &FrameEvent, writer: &mut Writer) {
    let FrameEvent {
        frame,
        session,
        sequence,
        stamp_ns,
        odometry,
        observation,
        decision,
        new_place_posterior,
        proposal,
        candidates,
        learnt,
        link,
        at,
        belief,
        look_alike_inliers,
    } = event;
    writer.u64(*frame);
    writer.u32(*session);
    writer.u64(*sequence);
    writer.i64(*stamp_ns);
    encode_option(odometry.as_ref(), writer, Odometry::encode);
    observation.encode(writer);
    let Decision { reason, place, posterior, closure } = decision;
    writer.u8(reason.code());
    encode_option(place.as_ref(), writer, |place, writer| writer.u32(place.number()));
    writer.f64(*posterior);
    encode_option(closure.as_ref(), writer, Match::encode);
    writer.f64(*new_place_posterior);
    encode_option(proposal.as_ref(), writer, Match::encode);
    writer.varint(candidates.len() as u64);
    candidates.iter().for_each(|candidate| candidate.encode(writer));
    writer.u8(u8::from(*learnt));
    encode_option(link.as_ref(), writer, Link::encode);
    encode_option(at.as_ref(), writer, RelativePose::encode);
    encode_belief(belief, writer);
    encode_option(look_alike_inliers.as_ref(), writer, |inliers, writer| writer.f64(*inliers));
}

fn decode_frame(
    version: u8,
    reader: &mut Reader<'_>,
    vocabulary_len: usize,
) -> Result<FrameEvent, DecodeError> {
    Ok(FrameEvent {
        frame: reader.u64()?,
        session: reader.u32()?,
        sequence: reader.u64()?,
        stamp_ns: reader.i64()?,
        odometry: decode_option(reader, Odometry::decode)?,
        observation: Observation::decode(reader, vocabulary_len)?,
        decision: Decision {
            reason: Reason::from_code(reader.u8()?)?,
            place: decode_option(reader, Reader::u32)?.map(PlaceId::new),
            posterior: reader.f64()?,
            closure: decode_option(reader, Match::decode)?,
        },
        new_place_posterior: reader.f64()?,
        proposal: decode_option(reader, Match::decode)?,
        candidates: if version > VERSION_BEFORE_VERIFICATION {
            decode_candidates(version, reader)?
        } else {
            Vec::new()
        },
        learnt: decode_flag(reader)?,
        link: decode_option(reader, Link::decode)?,
        at: if version > VERSION_BEFORE_POSES { decode_option(reader, RelativePose::decode)? } else { None },
        belief: decode_belief(reader)?,
        look_alike_inliers: if version > VERSION_BEFORE_PROBABILITY {
            decode_option(reader, |reader| not_negative(reader.f64()?))?
        } else {
            None
        },
    })
}

impl MeasuredEvent {
    fn encode(&self, writer: &mut Writer) {
        let Self { position, session, frame, earlier, place, at, link, goes_on_from } = self;
        writer.u64(*position);
        writer.u32(*session);
        writer.u64(*frame);
        writer.u64(*earlier);
        writer.u32(place.number());
        at.encode(writer);
        encode_option(link.as_ref(), writer, Link::encode);
        encode_option(goes_on_from.as_ref(), writer, Odometry::encode);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            position: reader.u64()?,
            session: reader.u32()?,
            frame: reader.u64()?,
            earlier: reader.u64()?,
            place: PlaceId::new(reader.u32()?),
            at: RelativePose::decode(reader)?,
            link: decode_option(reader, Link::decode)?,
            goes_on_from: decode_option(reader, Odometry::decode)?,
        })
    }
}

/// Least bytes of a candidate.
const CANDIDATE_BYTES: usize = 37;

fn decode_candidates(version: u8, reader: &mut Reader<'_>) -> Result<Vec<Candidate>, DecodeError> {
    let form = if version > VERSION_BEFORE_PROBABILITY {
        CandidateForm::WithProbability
    } else if version > VERSION_BEFORE_PLACEMENT {
        CandidateForm::WithPlacement
    } else {
        CandidateForm::WithoutPlacement
    };
    let count = reader.count(CANDIDATE_BYTES)?;
    if count > VerificationSettings::MAX_CANDIDATES {
        return Err(DecodeError::invalid(format_args!("{count} candidates of one frame")));
    }
    (0..count).map(|_| Candidate::decode(form, reader)).collect()
}

impl Reason {
    fn code(self) -> u8 {
        match self {
            Reason::NewPlace => 0,
            Reason::SamePlace => 1,
            Reason::LoopClosure => 2,
            Reason::BelowThreshold => 3,
            Reason::TooFewWords => 4,
            Reason::GeometryRefused => 5,
        }
    }

    fn from_code(code: u8) -> Result<Self, DecodeError> {
        match code {
            0 => Ok(Reason::NewPlace),
            1 => Ok(Reason::SamePlace),
            2 => Ok(Reason::LoopClosure),
            3 => Ok(Reason::BelowThreshold),
            4 => Ok(Reason::TooFewWords),
            5 => Ok(Reason::GeometryRefused),
            other => Err(DecodeError::invalid(format_args!("reason {other}"))),
        }
    }
}
