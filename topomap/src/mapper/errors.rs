//! What can go wrong with a map's settings, frames and log.

use fabmap::appearance::PlaceId;
use fabmap::codec::DecodeError;
use fabmap::observation::WordId;

use crate::evidence::{Bound, Check};
use crate::ids::SessionId;
use crate::log::Reason;
use crate::settings::MapperError;

/// Why a frame was not taken. Nothing has changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// The session was never opened here.
    #[error("session {session} is not open in this map; open a session first")]
    UnknownSession {
        /// The session.
        session: SessionId,
    },
    /// The frame's number is not above the last one.
    #[error("sequence number {sequence} is not above {last}, the last one committed; number frames upwards")]
    SequenceNotRising {
        /// The number given.
        sequence: u64,
        /// The last one committed.
        last: u64,
    },
    /// The frame is older than the one before.
    #[error(
        "the stamp {stamp_ns} ns is not after {last_ns} ns, the previous frame's; send frames in the order they were \
         taken, with the robot's own steady clock"
    )]
    StampNotRising {
        /// The stamp given.
        stamp_ns: i64,
        /// The stamp of the frame before.
        last_ns: i64,
    },
    /// The odometry moved faster than any robot.
    #[error(
        "the odometry jumped {distance_m:.1} m in {elapsed_s:.3} s, faster than {max_speed_m_per_s} m/s; if the odom frame \
         was reset, open a new session; if not, check units (metres, nanoseconds)"
    )]
    OdometryJump {
        /// How far it moved.
        distance_m: f64,
        /// In which time.
        elapsed_s: f64,
        /// The highest speed allowed.
        max_speed_m_per_s: f64,
    },
    /// The wheels say that the robot stands, the camera that it does not.
    #[error(
        "the odometry has not changed for {frames} frames, but the view has: check that the encoders are read, or leave the \
         odometry out; if the robot really stands, whatever hides the view has to pass"
    )]
    OdometryStandsStill {
        /// Frames at one place, this one included.
        frames: u64,
    },
    /// The observation is of another vocabulary.
    #[error(
        "the frame has word {word}, this map's vocabulary {vocabulary_len} words; use the map's own model"
    )]
    ForeignWord {
        /// The word.
        word: WordId,
        /// Words in the map's vocabulary.
        vocabulary_len: usize,
    },
}

/// Why what a robot measured by itself was not taken. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MeasureError {
    /// The frames are one, or the wrong way round.
    #[error("the earlier frame did not come in before the other; name the frame first that came in last")]
    NotEarlier,
    /// A person took a frame's place back.
    #[error("the loop closure of the {which} frame was withdrawn; measure from another frame")]
    Withdrawn {
        /// `earlier` or `later`.
        which: &'static str,
    },
    /// A frame is nowhere in metres.
    #[error(
        "the {which} frame has no place with odometry, so that the map knows no metres there; measure between frames \
         that were sent with odometry"
    )]
    NoMetres {
        /// `earlier` or `later`.
        which: &'static str,
    },
    /// Nothing would follow from it.
    #[error(
        "both frames are of one place and the robot has driven on since; send what it measures before its next frame"
    )]
    TooLate,
    /// The robot is known better already.
    #[error(
        "the measurement's position is known to {sigma_m:.2} m alone, and the robot is at a place of {spacing_m} m already; \
         leave it out, or send the covariance of what is really known"
    )]
    TooUnsure {
        /// Standard deviation of the position in the place's frame, in metres.
        sigma_m: f64,
        /// The map's place spacing, in metres.
        spacing_m: f64,
    },
}

/// Why what a person said was not taken. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CorrectError {
    /// There is nothing to take back.
    #[error(
        "the frame closed no loop ({}), so that there is nothing to withdraw; list the map's loop closures to see \
         which did",
        decided(*reason)
    )]
    NoClosure {
        /// What was decided.
        reason: Reason,
    },
    /// It was taken back before.
    #[error(
        "the loop closure of the frame was withdrawn by correction {correction}; undo that to have it back"
    )]
    Withdrawn {
        /// Position of the correction.
        correction: u64,
    },
    /// Another correction says that a frame of it is where it is.
    #[error(
        "correction {correction} says that a frame of this visit is at the same place as another one; undo that first"
    )]
    RestsOnIt {
        /// Position of the correction.
        correction: u64,
    },
    /// The frames are one, or the wrong way round.
    #[error("the matched frame did not come in before the other; name the frame first that came in last")]
    NotEarlier,
    /// A frame is at no place.
    #[error(
        "the {which} frame is at no place: it showed too little, or its place was dropped; name another frame"
    )]
    NoPlace {
        /// `earlier` or `later`.
        which: &'static str,
    },
    /// The map has them at one place.
    #[error("both frames are at place {place} already")]
    SamePlace {
        /// The place.
        place: PlaceId,
    },
    /// It was said before.
    #[error("correction {correction} says so already")]
    Confirmed {
        /// Position of the correction.
        correction: u64,
    },
    /// The map has metres, and nothing to measure by.
    #[error(
        "the frames are at places with metres, and how they lie to each other cannot be measured: the map keeps no features \
         of one of them; name two frames whose features it keeps"
    )]
    NoFeatures,
    /// The two views do not look like one place.
    #[error(
        "the frames are at places with metres, and how they lie to each other cannot be measured: {}; name two frames \
         that were taken nearer to each other",
        told(failed)
    )]
    Refused {
        /// What the views have to show and do not.
        failed: Check,
    },
    /// The two views have something in common that does not say where the robot was.
    #[error(
        "the frames are at places with metres, and what they have in common does not say how they lie to each other; name \
         two frames that were taken nearer to each other, and declare the camera of the sessions"
    )]
    Unmeasured,
    /// There is no such correction.
    #[error("the map has no correction {correction} that stands; list its corrections to see what there is")]
    Unknown {
        /// Position of the correction.
        correction: u64,
    },
    /// Others came later.
    #[error(
        "correction {later} came after correction {correction} and is about the same session; undo that first"
    )]
    Later {
        /// Position of the correction.
        correction: u64,
        /// And of the last one.
        later: u64,
    },
}

fn told(Check { quantity, value, bound }: &Check) -> String {
    match bound {
        Bound::AtLeast(least) => format!("{quantity} of {value:.2} where at least {least:.2} are needed"),
        Bound::AtMost(most) => format!("{quantity} of {value:.2} where at most {most:.2} is allowed"),
    }
}

/// An event that is not the next of a map's log: the log is damaged, or of another map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FoldError {
    /// It stands elsewhere in the log.
    #[error(
        "event {found} of the log stands where {expected} should; the log is damaged, restore it from a copy"
    )]
    Position {
        /// The position that comes next.
        expected: u64,
        /// The event's own.
        found: u64,
    },
    /// It names a session that cannot be.
    #[error("the log names session {session} out of order; the log is damaged, restore it from a copy")]
    Session {
        /// The session.
        session: SessionId,
    },
    /// It corrects what is not there.
    #[error(
        "event {position} of the log corrects what is not there; the log is damaged, restore it from a copy"
    )]
    Correction {
        /// The event's position.
        position: u64,
    },
    /// It names a place that does not exist.
    #[error("the log names place {place}, which does not exist; the log is damaged, restore it from a copy")]
    Place {
        /// The place.
        place: PlaceId,
    },
    /// It has a word that the map's vocabulary does not.
    #[error(
        "the log has word {word} of another vocabulary; the map's model was exchanged, bring back the original"
    )]
    Word {
        /// The word.
        word: WordId,
    },
}

/// A map could not be opened from its checkpoint.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RestoreError {
    /// Bytes that are no checkpoint.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// Settings that the model does not bear.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// Pieces are missing.
    #[error("the checkpoint's {what} are missing from number {from} on")]
    Missing {
        /// `places`, `links` or `sessions`.
        what: &'static str,
        /// The first that is missing.
        from: u64,
    },
    /// Pieces of another checkpoint are among them.
    #[error("the checkpoint has more {what} than the {expected} that its head says")]
    TooMany {
        /// `places`, `links` or `sessions`.
        what: &'static str,
        /// How many there should be.
        expected: u64,
    },
}

/// What a frame was decided to be, in words.
fn decided(reason: Reason) -> &'static str {
    match reason {
        Reason::NewPlace => "it was at a new place",
        Reason::SamePlace => "it was at the same place as before",
        Reason::LoopClosure => "it closed one",
        Reason::BelowThreshold => "what it looked like stayed below the threshold",
        Reason::TooFewWords => "it showed too few words",
        Reason::GeometryRefused => "geometry refused what it looked like",
    }
}
