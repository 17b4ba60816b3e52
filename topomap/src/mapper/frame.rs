//! A frame as it comes in, and the moment that it meets the map.

use std::borrow::Cow;

use fabmap::appearance::PlaceId;
use fabmap::observation::Observation;
use fabmap::recognizer::{Association, Recognition};

use super::FrameError;
use super::state::Mapper;
use crate::ids::{FrameId, SessionId};
use crate::map::{PlaceFrame, Session};
use crate::metric::Odometry;

/// A frame as it comes from a robot, in words.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameInput {
    /// The session, which must be open; [`super::Localizer::SESSION`] if it is none of the log.
    pub session: SessionId,
    /// The robot's number of the frame.
    pub sequence: u64,
    /// When the image was taken, by the robot's clock, in nanoseconds.
    pub stamp_ns: i64,
    /// Where the wheels put the robot then.
    pub odometry: Option<Odometry>,
    /// What was seen.
    pub observation: Observation,
}

/// Whether a frame may leave something behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Growth {
    Grows,
    ReadOnly,
}

/// A frame that was accepted and recognised, beside the map and the session as they were when it
/// came in.
#[derive(Clone, Debug)]
pub(super) struct FrameInHand<'a> {
    pub(super) mapper: &'a Mapper,
    pub(super) session: Cow<'a, Session>,
    pub(super) growth: Growth,
    pub(super) input: FrameInput,
    pub(super) recognition: Recognition,
    /// The most probable of all places and "somewhere new", by `recognition`.
    pub(super) association: Association,
    /// What the best look-alike is expected to show by itself; `None` where nothing is verified, or
    /// the frame shows too little.
    pub(super) look_alike_inliers: Option<f64>,
}

impl FrameInHand<'_> {
    /// Whether the frame has too few words to say anything.
    pub(super) fn shows_too_little(&self) -> bool {
        self.input.observation.len() < self.mapper.settings().min_words
    }

    /// Whether the session is at a place or has left it within the guard.
    pub(super) fn was_just_at(&self, place: PlaceId) -> bool {
        self.session.is_near(place, self.mapper.settings())
    }

    /// The frames that a place has learnt from, oldest first; none of a place that does not exist.
    pub(super) fn frames_of(&self, place: PlaceId) -> &[PlaceFrame] {
        self.mapper.map().places().get(place as usize).map_or(&[], |place| &place.frames)
    }

    /// Frames that a place learnt from, latest first, but for those that the session has sent
    /// within the guard.
    pub(super) fn frames_before_guard(&self, place: PlaceId) -> impl Iterator<Item = FrameId> {
        let settings = self.mapper.settings();
        let is_earlier = |frame: &&PlaceFrame| {
            frame.session != self.input.session || !self.session.is_guarded(frame.number, settings)
        };
        self.frames_of(place).iter().rev().filter(is_earlier).map(|frame| frame.frame)
    }
}

impl Mapper {
    /// What can be said against a frame before looking at it.
    pub(super) fn accept(&self, input: &FrameInput, session: &Session) -> Result<(), FrameError> {
        if let Some(last) = session.last_sequence.filter(|&last| input.sequence <= last) {
            return Err(FrameError::SequenceNotRising { sequence: input.sequence, last });
        }
        if let Some(last_ns) = session.last_stamp_ns.filter(|&last| input.stamp_ns <= last) {
            return Err(FrameError::StampNotRising { stamp_ns: input.stamp_ns, last_ns });
        }
        self.check_words(&input.observation)?;
        if let (Some((then_ns, before)), Some(now)) = (&session.last_odometry, &input.odometry) {
            let elapsed_s = (input.stamp_ns.saturating_sub(*then_ns)) as f64 * 1e-9;
            let max_speed_m_per_s = self.settings().max_speed_m_per_s;
            if now.has_jumped(before, elapsed_s, max_speed_m_per_s) {
                let distance_m = now.distance_m(before);
                return Err(FrameError::OdometryJump { distance_m, elapsed_s, max_speed_m_per_s });
            }
        }
        Ok(())
    }

    /// Whether all words are of the map's vocabulary.
    pub(super) fn check_words(&self, observation: &Observation) -> Result<(), FrameError> {
        let vocabulary_len = self.vocabulary_len();
        match observation.words().last().filter(|&&word| word.index() >= vocabulary_len) {
            Some(&word) => Err(FrameError::ForeignWord { word, vocabulary_len }),
            None => Ok(()),
        }
    }
}
