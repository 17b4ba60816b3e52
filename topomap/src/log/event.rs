//! What the log of a map holds: facts and decisions, never what can be computed from them.

use fabmap::appearance::PlaceId;
use fabmap::observation::Observation;
use fabmap::place_filter::{Belief, PlaceDistribution};

use super::correction::CorrectionEvent;
use super::link::Link;
use crate::evidence::{Candidate, Match};
use crate::ids::{FrameId, SessionId};
use crate::metric::{Odometry, RelativePose};

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
    /// A person said that a loop closure is none, or that two places are one.
    Corrected(Box<CorrectionEvent>),
}

impl MapEvent {
    /// The session that it belongs to.
    #[must_use]
    pub fn session(&self) -> SessionId {
        match self {
            MapEvent::SessionOpened { session } => *session,
            MapEvent::Frame(event) => event.session,
            MapEvent::Measured(event) => event.session,
            MapEvent::Corrected(event) => event.session,
        }
    }
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
    /// most probable place known from before the guard, the frame that matches best; with geometry,
    /// of the place that it has most evidence for. None if too little was seen to say anything.
    pub proposal: Option<Match>,
    /// What geometry was asked about: at most
    /// [`crate::evidence::VerificationSettings::MAX_CANDIDATES`], each of another place. The
    /// proposal and a verified closure are among them. Empty where nothing is verified.
    pub candidates: Vec<Candidate>,
    /// Whether the place takes this look into its appearance.
    pub learnt: bool,
    /// A link that this frame adds.
    pub link: Option<Link>,
    /// Where in its place's frame the robot is, if wheels or a closure measured it.
    pub at: Option<RelativePose>,
    /// What the next frame of the session starts from.
    pub belief: Belief,
    /// What the best look-alike of a frame like this one and the last ones is expected to show by
    /// itself, in inliers; `None` where nothing was compared.
    pub look_alike_inliers: Option<f64>,
}

impl FrameEvent {
    /// What verified the loop closure that was accepted; `None` if none was, or nothing was
    /// verified.
    #[must_use]
    pub fn verified_by(&self) -> Option<&Candidate> {
        let closure = self.decision.closure.filter(|_| self.decision.reason == Reason::LoopClosure)?;
        let is_closure = |candidate: &&Candidate| candidate.matched.frame == closure.frame;
        self.candidates.iter().find(is_closure).filter(|candidate| candidate.view.is_some())
    }
}

/// What a robot measured by itself, by stereo, depth or a marker: where it was at a frame, seen
/// from an earlier one.
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

impl Decision {
    /// What the next frame of the session starts from: the posterior, carried on by a map of so
    /// many places before the decision; the belief before, if too little was seen.
    #[must_use]
    pub fn belief_after(&self, before: &Belief, posterior: &PlaceDistribution, places: usize) -> Belief {
        let created = self.place.filter(|&place| place.index() == places);
        if self.is_of_too_few_words() { before.clone() } else { posterior.carry(created) }
    }

    /// p(new | Z), or what was believed before if too little was seen.
    #[must_use]
    pub fn new_place_posterior(&self, before: &Belief, posterior: &PlaceDistribution) -> f64 {
        if self.is_of_too_few_words() { before.new_place } else { posterior.new_place }
    }

    fn is_of_too_few_words(&self) -> bool {
        self.reason == Reason::TooFewWords
    }
}

/// Why a frame was decided as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reason {
    /// Somewhere new was the most probable, or wheels say that the robot has left the place it was
    /// at: a place was created.
    NewPlace,
    /// The place the session is at, or has just left.
    SamePlace,
    /// Another place, above the threshold; with geometry, one that it verified.
    LoopClosure,
    /// Another place was the most probable, but below the threshold, by words or by all that speaks
    /// for it together: a place was created, because a place too many can be fused later and a wrong
    /// one cannot be taken apart.
    BelowThreshold,
    /// Too few words to say anything: nothing was created or learnt.
    TooFewWords,
    /// By words a known place was above the threshold, the one where the session is or another, but
    /// its views show another scene, or one seen from elsewhere: a place was created, as for
    /// [`Reason::BelowThreshold`].
    GeometryRefused,
}
