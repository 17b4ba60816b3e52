//! What the log of a map holds: facts and decisions, never what can be computed from them.

use fabmap::appearance::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};
use fabmap::observation::Observation;
use fabmap::place_filter::Belief;
use nalgebra::Isometry3;

use crate::odometry::{Odometry, decode_pose, encode_pose};
use crate::relative_pose::RelativePose;
use crate::verification::{Candidate, VerificationSettings};

/// A frame's number within its map: its position in the log.
pub type FrameId = u64;

/// A session's number within its map, counted from 0.
pub type SessionId = u32;

/// One entry of a map's log.
#[derive(Clone, Debug, PartialEq)]
pub enum MapEvent {
    /// A robot began a run.
    SessionOpened {
        /// The next session number.
        session: SessionId,
    },
    /// A frame came in and was decided.
    Frame(Box<FrameEvent>),
    /// A robot measured by itself how two frames lie to each other.
    Measured(Box<MeasuredEvent>),
}

/// A frame and all that was decided about it.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEvent {
    /// Position in the log.
    pub frame: FrameId,
    /// The session it came from.
    pub session: SessionId,
    /// The robot's number of the frame, rising within the session.
    pub sequence: u64,
    /// When the image was taken, by the robot's clock, in nanoseconds.
    pub stamp_ns: i64,
    /// Where the wheels put the robot then.
    pub odometry: Option<Odometry>,
    /// What was seen.
    pub observation: Observation,
    /// What was decided.
    pub decision: Decision,
    /// p(new | Z).
    pub new_place_posterior: f64,
    /// The earlier frame that a judge of loop closures would be shown, whatever was decided: of the
    /// most probable place known from before the guard, the frame that matches best; with geometry, of the
    /// place that it has most evidence for. None if too little was seen to say anything.
    pub proposal: Option<Match>,
    /// What geometry was asked about: at most [`VerificationSettings::MAX_CANDIDATES`], each of another place.
    /// The proposal and a verified closure are among them. Empty where nothing is verified.
    pub candidates: Vec<Candidate>,
    /// Whether the place takes this look into its appearance.
    pub learnt: bool,
    /// A link that this frame adds.
    pub link: Option<Link>,
    /// Where in its place's frame the robot is, if wheels or a closure measured it.
    pub at: Option<RelativePose>,
    /// What the next frame of the session starts from.
    pub belief: Belief,
}

impl FrameEvent {
    /// What verified the loop closure that was accepted; `None` if none was, or nothing was verified.
    #[must_use]
    pub fn verified_by(&self) -> Option<&Candidate> {
        let closure = self.decision.closure.filter(|_| self.decision.reason == Reason::LoopClosure)?;
        let is_closure = |candidate: &&Candidate| candidate.matched.frame == closure.frame;
        self.candidates.iter().find(is_closure).filter(|candidate| candidate.view.is_some())
    }
}

/// What a robot measured by itself, by stereo, depth or a marker: where it was at a frame, seen from an earlier one.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredEvent {
    /// Position in the log.
    pub position: u64,
    /// The session of `frame`.
    pub session: SessionId,
    /// The frame.
    pub frame: FrameId,
    /// The earlier one.
    pub earlier: FrameId,
    /// The place of `earlier`.
    pub place: PlaceId,
    /// Where in that place's frame the robot was at `frame`.
    pub at: RelativePose,
    /// A link that this adds.
    pub link: Option<Link>,
    /// Odometry of `frame`, if the session has not gone on since: its wheels then go on from `at`.
    pub goes_on_from: Option<Odometry>,
}

/// The decision about one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Why.
    pub reason: Reason,
    /// The place that the frame belongs to; `None` if too little was seen to say.
    pub place: Option<PlaceId>,
    /// Posterior probability of what was decided: the place's, or that of a new place.
    pub posterior: f64,
    /// For a loop closure, accepted or not: the place and its frame that matched best.
    pub closure: Option<Match>,
}

/// An earlier frame of a place, as a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The place.
    pub place: PlaceId,
    /// Its posterior probability.
    pub posterior: f64,
    /// ln [posterior / (1 - posterior)], nats: tells apart what rounds to 1.
    pub log_odds: f64,
    /// Of the frames that the place has learnt from, the one that explains the observation best.
    pub frame: FrameId,
}

/// Why a frame was decided as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reason {
    /// Somewhere new was the most probable, or wheels say that the robot has left the place it was at: a place was
    /// created.
    NewPlace,
    /// The place the session is at, or has just left.
    SamePlace,
    /// Another place, above the threshold; with geometry, one that it verified.
    LoopClosure,
    /// Another place was the most probable, but below the threshold: a place was created, because a
    /// place too many can be fused later and a wrong one cannot be taken apart.
    BelowThreshold,
    /// Too few words to say anything: nothing was created or learnt.
    TooFewWords,
    /// A known place was above the threshold, the one where the session is or another, but geometry refused it,
    /// or there were no keypoints to look at: a place was created, as for [`Reason::BelowThreshold`].
    GeometryRefused,
}

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
    /// It did, and odometry measured the way: the pose of `to`'s frame in `from`'s. Logs before version 3 have
    /// these, without covariances.
    Odometry(Isometry3<f64>),
    /// A session drove from one to the other, and odometry measured the way: the pose of `to` in the frame of `from`.
    Driven(RelativePose),
    /// A session drove there and recognised where it was: the same, by odometry and what the closure, or the robot
    /// itself, measured.
    Closed(RelativePose),
}

/// Version of the byte form of [`MapEvent`]; 2 added the candidates, 3 where in its place the robot is, 4 what robots
/// measured by themselves.
const VERSION: u8 = 4;
const VERSION_BEFORE_POSES: u8 = 2;
const VERSION_BEFORE_VERIFICATION: u8 = 1;
const SESSION_OPENED: u8 = 0;
const FRAME: u8 = 1;
const MEASURED: u8 = 2;

impl MapEvent {
    /// The session that it belongs to.
    #[must_use]
    pub fn session(&self) -> SessionId {
        match self {
            MapEvent::SessionOpened { session } => *session,
            MapEvent::Frame(event) => event.session,
            MapEvent::Measured(event) => event.session,
        }
    }

    /// The byte form that the log keeps.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.u8(VERSION);
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
        }
        writer.into_bytes()
    }

    /// Reads what [`MapEvent::to_bytes`] wrote, for a map over a vocabulary of `vocabulary_len` words.
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
    } = event;
    writer.u64(*frame);
    writer.u32(*session);
    writer.u64(*sequence);
    writer.i64(*stamp_ns);
    encode_option(odometry.as_ref(), writer, Odometry::encode);
    observation.encode(writer);
    let Decision { reason, place, posterior, closure } = decision;
    writer.u8(reason.code());
    encode_option(place.as_ref(), writer, |place, writer| writer.u32(*place));
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
            place: decode_option(reader, Reader::u32)?,
            posterior: reader.f64()?,
            closure: decode_option(reader, Match::decode)?,
        },
        new_place_posterior: reader.f64()?,
        proposal: decode_option(reader, Match::decode)?,
        candidates: if version > VERSION_BEFORE_VERIFICATION {
            decode_candidates(reader)?
        } else {
            Vec::new()
        },
        learnt: decode_flag(reader)?,
        link: decode_option(reader, Link::decode)?,
        at: if version > VERSION_BEFORE_POSES { decode_option(reader, RelativePose::decode)? } else { None },
        belief: decode_belief(reader)?,
    })
}

impl MeasuredEvent {
    fn encode(&self, writer: &mut Writer) {
        let Self { position, session, frame, earlier, place, at, link, goes_on_from } = self;
        writer.u64(*position);
        writer.u32(*session);
        writer.u64(*frame);
        writer.u64(*earlier);
        writer.u32(*place);
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
            place: reader.u32()?,
            at: RelativePose::decode(reader)?,
            link: decode_option(reader, Link::decode)?,
            goes_on_from: decode_option(reader, Odometry::decode)?,
        })
    }
}

/// Least bytes of a candidate.
const CANDIDATE_BYTES: usize = 37;

fn decode_candidates(reader: &mut Reader<'_>) -> Result<Vec<Candidate>, DecodeError> {
    let count = reader.count(CANDIDATE_BYTES)?;
    if count > VerificationSettings::MAX_CANDIDATES {
        return Err(DecodeError::invalid(format_args!("{count} candidates of one frame")));
    }
    (0..count).map(|_| Candidate::decode(reader)).collect()
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

impl Match {
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Match { place, posterior, log_odds, frame } = self;
        writer.u32(*place);
        writer.f64(*posterior);
        writer.f64(*log_odds);
        writer.u64(*frame);
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Match {
            place: reader.u32()?,
            posterior: reader.f64()?,
            log_odds: reader.f64()?,
            frame: reader.u64()?,
        })
    }
}

impl Link {
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Link { from, to, kind } = self;
        writer.u32(*from);
        writer.u32(*to);
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
            from: reader.u32()?,
            to: reader.u32()?,
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

pub(crate) fn encode_belief(belief: &Belief, writer: &mut Writer) {
    let Belief { places, new_place, remainder } = belief;
    writer.varint(places.len() as u64);
    for &(place, probability) in places {
        writer.u32(place);
        writer.f64(probability);
    }
    writer.f64(*new_place);
    writer.f64(*remainder);
}

pub(crate) fn decode_belief(reader: &mut Reader<'_>) -> Result<Belief, DecodeError> {
    let places = reader.count(12)?;
    if places > Belief::MAX_PLACES {
        return Err(DecodeError::invalid(format_args!("a belief of {places} places")));
    }
    let places =
        (0..places).map(|_| Ok((reader.u32()?, reader.f64()?))).collect::<Result<Vec<_>, DecodeError>>()?;
    Ok(Belief { places, new_place: reader.f64()?, remainder: reader.f64()? })
}

pub(crate) fn encode_option<T>(value: Option<&T>, writer: &mut Writer, encode: impl FnOnce(&T, &mut Writer)) {
    writer.u8(u8::from(value.is_some()));
    if let Some(value) = value {
        encode(value, writer);
    }
}

pub(crate) fn decode_option<'a, T>(
    reader: &mut Reader<'a>,
    decode: impl FnOnce(&mut Reader<'a>) -> Result<T, DecodeError>,
) -> Result<Option<T>, DecodeError> {
    if decode_flag(reader)? { decode(reader).map(Some) } else { Ok(None) }
}

fn decode_flag(reader: &mut Reader<'_>) -> Result<bool, DecodeError> {
    match reader.u8()? {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(DecodeError::invalid(format_args!("flag {other}"))),
    }
}
