//! The story of a frame: recognise, propose, decide, link; then fold what was decided into the map.

mod candidates;
mod errors;
mod gates;
mod localizer;
mod measuring;
mod poses;
mod settings;
mod state;

pub use errors::{ArchiveError, FoldError, FrameError, MapperError, MeasureError, RestoreError};
pub use gates::{Gate, Gates};
pub use localizer::{Localizer, Queried};
pub use measuring::Measurement;
use poses::Located;
pub use poses::MapPose;
pub use settings::{MapperSettings, PlaceRule};

use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::recognizer::{Association, Recognition, Recognizer, Stage, StageObserver};

use crate::event::{Decision, FrameEvent, FrameId, Link, LinkKind, Match, Reason, SessionId};
use crate::map::{MAX_PAST_FRAMES, Map, PlaceFrame, Session};
use crate::odometry::Odometry;
use crate::place_poses::PlacePoses;
use crate::relative_pose::RelativePose;
use crate::verification::{Candidate, Views};

/// A map that grows: recognizer and place graph, driven by events.
///
/// [`Mapper::decide`] changes nothing; [`Mapper::apply`] is the fold. Whoever holds the log commits
/// between the two, or after both and before anyone is told.
#[derive(Clone, Debug)]
pub struct Mapper {
    recognizer: Recognizer,
    map: Map,
    /// Derived from the map's links.
    poses: PlacePoses,
    settings: MapperSettings,
    vocabulary_len: usize,
}

/// A frame as it comes from a robot, in words.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameInput {
    /// The session, which must be open; [`Localizer::SESSION`] if it is none of the log.
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

/// Gives back what earlier frames showed; whoever keeps the log implements it.
pub trait FrameArchive {
    /// The observation of a frame that a place learnt from; `None` if it is lost for good: the frame
    /// is then left out of the comparison.
    ///
    /// # Errors
    /// [`ArchiveError`] if it cannot be read now.
    fn observation(&self, frame: FrameId) -> Result<Option<Observation>, ArchiveError>;

    /// Where in its place's frame the robot was at that frame ([`FrameEvent::at`]); `None` if that was not measured
    /// or is lost.
    ///
    /// # Errors
    /// [`ArchiveError`] if it cannot be read now.
    fn at(&self, frame: FrameId) -> Result<Option<RelativePose>, ArchiveError>;
}

/// What is known of a frame besides its decision, for those who ask why.
#[derive(Clone, Debug, PartialEq)]
pub struct Decided {
    /// What is to be logged.
    pub event: FrameEvent,
    /// Likelihoods, prior and posterior behind it.
    pub recognition: Recognition,
}

impl Mapper {
    /// An empty map over `model`.
    ///
    /// # Errors
    /// [`MapperError`] if a setting is out of range.
    pub fn new(model: &Model, settings: MapperSettings) -> Result<Self, MapperError> {
        let MapperSettings { closure_threshold, looks_per_stay, max_speed_m_per_s, .. } = settings;
        if !(closure_threshold > 0.0 && closure_threshold <= 1.0) {
            return Err(MapperError::ClosureThreshold { value: closure_threshold });
        }
        if looks_per_stay == 0 {
            return Err(MapperError::LooksPerStay);
        }
        if max_speed_m_per_s.is_nan() || max_speed_m_per_s <= 0.0 {
            return Err(MapperError::MaxSpeed { value: max_speed_m_per_s });
        }
        settings.verification.check()?;
        settings.check_metric()?;
        Ok(Self {
            recognizer: Recognizer::new(model, settings.recognizer)?,
            map: Map::default(),
            poses: PlacePoses::default(),
            settings,
            vocabulary_len: model.vocabulary().len(),
        })
    }

    /// Decides what a frame is: the story, from the observation to the event that the log keeps.
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be taken; nothing changes either way.
    pub fn decide(
        &self,
        input: FrameInput,
        archive: &dyn FrameArchive,
        views: &dyn Views,
        observer: &mut dyn StageObserver,
    ) -> Result<Decided, FrameError> {
        let session =
            self.map.session(input.session).ok_or(FrameError::UnknownSession { session: input.session })?;
        self.decide_within(Growth::Grows, session, input, (archive, views), observer)
    }

    /// The story, for a session of the log or one that only looks.
    fn decide_within(
        &self,
        growth: Growth,
        session: &Session,
        input: FrameInput,
        (archive, views): (&dyn FrameArchive, &dyn Views),
        observer: &mut dyn StageObserver,
    ) -> Result<Decided, FrameError> {
        self.accept(&input, session)?;
        let motion = self.motion_prior(session, input.odometry.as_ref());
        let recognition = self.recognizer.recognize(&input.observation, &motion, observer);
        let candidates =
            self.compare(&input.observation, (input.session, session), &recognition, archive, views)?;
        if self.verifies() {
            observer.completed(Stage::Verification);
        }
        let proposal = self.propose(&input, session, &recognition, &candidates, archive)?;
        let decision = match (growth, self.settings.place_rule) {
            (Growth::Grows, PlaceRule::EachFrame) => {
                self.place_of_its_own(&input, session, &recognition, views)?
            }
            (Growth::Grows, PlaceRule::Unrecognized) | (Growth::ReadOnly, _) => {
                growth.limit(self.associate(&input, session, &recognition, &candidates, (archive, views))?)
            }
        };
        if growth == Growth::Grows {
            self.check_that_wheels_turn(&input, session, &recognition, &decision, views)?;
        }
        let located = self.locate(&input, session, &decision, &candidates, (archive, views))?;
        let (learnt, link) = match growth {
            Growth::Grows => (
                self.learns(session, &decision),
                self.link(session, &decision, input.odometry.as_ref(), located),
            ),
            Growth::ReadOnly => (false, None),
        };
        let created = decision.place.filter(|&place| place as usize == self.recognizer.places());
        let belief = match decision.reason {
            Reason::TooFewWords => session.belief.clone(),
            Reason::NewPlace
            | Reason::SamePlace
            | Reason::LoopClosure
            | Reason::BelowThreshold
            | Reason::GeometryRefused => recognition.posterior.carry(created),
        };
        let FrameInput { session, sequence, stamp_ns, odometry, observation } = input;
        let new_place_posterior = match decision.reason {
            Reason::TooFewWords => belief.new_place,
            Reason::NewPlace
            | Reason::SamePlace
            | Reason::LoopClosure
            | Reason::BelowThreshold
            | Reason::GeometryRefused => recognition.posterior.new_place,
        };
        let frame = self.map.events();
        let event = FrameEvent {
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
            at: located.map(|located| located.at()),
            belief,
        };
        Ok(Decided { event, recognition })
    }

    /// What can be said against a frame before looking at it.
    fn accept(&self, input: &FrameInput, session: &Session) -> Result<(), FrameError> {
        if let Some(last) = session.last_sequence.filter(|&last| input.sequence <= last) {
            return Err(FrameError::SequenceNotRising { sequence: input.sequence, last });
        }
        if let Some(last_ns) = session.last_stamp_ns.filter(|&last| input.stamp_ns <= last) {
            return Err(FrameError::StampNotRising { stamp_ns: input.stamp_ns, last_ns });
        }
        self.check_words(&input.observation)?;
        if let (Some((then_ns, before)), Some(now)) = (&session.last_odometry, &input.odometry) {
            let elapsed_s = (input.stamp_ns.saturating_sub(*then_ns)) as f64 * 1e-9;
            let max_speed_m_per_s = self.settings.max_speed_m_per_s;
            if now.has_jumped(before, elapsed_s, max_speed_m_per_s) {
                let distance_m = now.distance_m(before);
                return Err(FrameError::OdometryJump { distance_m, elapsed_s, max_speed_m_per_s });
            }
        }
        Ok(())
    }

    /// Wheels that do not turn would keep a robot that drives at one place for ever.
    fn check_that_wheels_turn(
        &self,
        input: &FrameInput,
        session: &Session,
        recognition: &Recognition,
        decision: &Decision,
        views: &dyn Views,
    ) -> Result<(), FrameError> {
        let (Reason::SamePlace, Some(place), Some(now)) = (decision.reason, decision.place, &input.odometry)
        else {
            return Ok(());
        };
        let looks_like_here = match recognition.association() {
            Association::Seen(seen) => {
                session.is_near(seen, self.settings.guard_frames) || self.map.linked(place).contains(&seen)
            }
            Association::New => false,
        };
        let frames = session.frames + 1 - session.left.back().map_or(0, |left| left.number);
        let stands = session.past.len() == MAX_PAST_FRAMES
            && session.past.iter().all(|past| past.odometry.pose() == now.pose());
        if stands
            && frames > STANDING_FRAMES
            && !looks_like_here
            && !self.is_on_the_same_spot(place, input.session, views)?
        {
            return Err(FrameError::OdometryStandsStill { frames });
        }
        Ok(())
    }

    fn check_words(&self, observation: &Observation) -> Result<(), FrameError> {
        let vocabulary_len = self.vocabulary_len;
        match observation.words().last().filter(|&&word| word as usize >= vocabulary_len) {
            Some(&word) => Err(FrameError::ForeignWord { word, vocabulary_len }),
            None => Ok(()),
        }
    }

    /// Of the most probable place known from before the guard, the frame that matches best; with geometry, the
    /// candidate that it has most evidence for.
    fn propose(
        &self,
        input: &FrameInput,
        session: &Session,
        recognition: &Recognition,
        candidates: &[Candidate],
        archive: &dyn FrameArchive,
    ) -> Result<Option<Match>, FrameError> {
        if self.shows_too_little(&input.observation) {
            return Ok(None);
        }
        if let Some(candidate) = candidates::most_likely(candidates) {
            return Ok(Some(candidate.matched));
        }
        let mut best: Option<(PlaceId, f64)> = None;
        for (place, &posterior) in (0..).zip(&recognition.posterior.places) {
            if best.is_none_or(|(_, best)| posterior > best)
                && self.frames_before_guard(place, input.session, session).next().is_some()
            {
                best = Some((place, posterior));
            }
        }
        match best {
            Some((place, _)) => {
                self.best_match(place, recognition, &input.observation, (input.session, session), archive)
            }
            None => Ok(None),
        }
    }

    /// Data association: what geometry verified, or else the most probable of all places and "somewhere new", unless
    /// geometry could have verified it.
    fn associate(
        &self,
        input: &FrameInput,
        session: &Session,
        recognition: &Recognition,
        candidates: &[Candidate],
        (archive, views): (&dyn FrameArchive, &dyn Views),
    ) -> Result<Decision, FrameError> {
        let posterior = &recognition.posterior;
        let next_place = self.recognizer.places() as PlaceId;
        let new_place = Decision {
            reason: Reason::NewPlace,
            place: Some(next_place),
            posterior: posterior.new_place,
            closure: None,
        };
        if self.shows_too_little(&input.observation) {
            let posterior = session.belief.new_place;
            return Ok(Decision { reason: Reason::TooFewWords, place: None, posterior, closure: None });
        }
        let same_place = |place: PlaceId| Decision {
            reason: Reason::SamePlace,
            place: Some(place),
            posterior: posterior.places[place as usize],
            closure: None,
        };
        let association = recognition.association();
        let robot = self.pose_of_robot(session, input.odometry.as_ref());
        let was_just_there = |place: PlaceId| session.is_near(place, self.settings.guard_frames);
        if let Association::Seen(place) = association
            && was_just_there(place)
            && robot.is_none_or(|robot| self.is_at(&robot, place))
            && self.may_have_stayed(place, input.session, views)?
        {
            return Ok(same_place(place));
        }
        if let Some(Candidate { matched, .. }) = self.verified(session, candidates) {
            let Match { place, posterior, .. } = *matched;
            let (place, closure) = (Some(place), Some(*matched));
            return Ok(Decision { reason: Reason::LoopClosure, place, posterior, closure });
        }
        if let (Some(robot), Some(stay)) = (robot, &session.stay)
            && self.is_at(&robot, stay.place)
        {
            return Ok(same_place(stay.place));
        }
        let Association::Seen(place) = association else { return Ok(new_place) };
        if robot.is_some() && was_just_there(place) {
            return Ok(new_place);
        }
        let probability = posterior.places[place as usize];
        let closure =
            self.best_match(place, recognition, &input.observation, (input.session, session), archive)?;
        if probability < self.settings.closure_threshold {
            return Ok(Decision { reason: Reason::BelowThreshold, closure, ..new_place });
        }
        if self.verifies() && !candidates::is_without_keypoints(candidates, place) {
            return Ok(Decision { reason: Reason::GeometryRefused, closure, ..new_place });
        }
        Ok(Decision { reason: Reason::LoopClosure, place: Some(place), posterior: probability, closure })
    }

    /// A new place whatever is recognised, unless the robot is at its last one still.
    fn place_of_its_own(
        &self,
        input: &FrameInput,
        session: &Session,
        recognition: &Recognition,
        views: &dyn Views,
    ) -> Result<Decision, FrameError> {
        let posterior = &recognition.posterior;
        let new_place = Decision {
            reason: Reason::NewPlace,
            place: Some(self.recognizer.places() as PlaceId),
            posterior: posterior.new_place,
            closure: None,
        };
        if self.shows_too_little(&input.observation) {
            let posterior = session.belief.new_place;
            return Ok(Decision { reason: Reason::TooFewWords, place: None, posterior, ..new_place });
        }
        let Some(stay) = &session.stay else { return Ok(new_place) };
        let robot = self.pose_of_robot(session, input.odometry.as_ref());
        let stands = robot.is_some_and(|robot| self.is_at(&robot, stay.place))
            || self.is_on_the_same_spot(stay.place, input.session, views)?;
        Ok(if stands {
            Decision {
                reason: Reason::SamePlace,
                place: Some(stay.place),
                posterior: posterior.places[stay.place as usize],
                closure: None,
            }
        } else {
            new_place
        })
    }

    /// Whether the frame shows all around what the first of the session's frames at `place` does: not the last one, or a
    /// robot that creeps would never leave.
    fn is_on_the_same_spot(
        &self,
        place: PlaceId,
        current: SessionId,
        views: &dyn Views,
    ) -> Result<bool, FrameError> {
        let frames = self.map.places().get(place as usize).map_or(&[][..], |place| &place.frames);
        let Some(first) = frames.iter().find(|frame| frame.session == current) else { return Ok(false) };
        Ok(views.turned(first.frame)?.is_some_and(|view| view.is_from_the_same_spot()))
    }

    /// Whether the place learns this look. A new place always does, or it would have no appearance.
    fn learns(&self, session: &Session, decision: &Decision) -> bool {
        decision.place.is_some_and(|place| {
            session.looks_of_stay(place, self.settings.guard_frames) < self.settings.looks_per_stay
        })
    }

    /// The way here from the place the session was at, or surely at if it is measured, unless the two are linked
    /// already.
    fn link(
        &self,
        session: &Session,
        decision: &Decision,
        odometry: Option<&Odometry>,
        located: Option<Located>,
    ) -> Option<Link> {
        let (stay, to) = (session.stay.as_ref()?, decision.place?);
        let (from, kind) = match (self.driven_from_anchor(session, odometry), located) {
            (Some((from, driven)), Some(Located::AtOrigin)) => (from, LinkKind::Driven(driven)),
            (Some((from, driven)), Some(Located::ByClosure(at))) => {
                (from, LinkKind::Closed(driven.then(&at.back())))
            }
            (Some(_) | None, Some(_) | None) => (stay.place, LinkKind::Session),
        };
        let linked = from == to || self.map.linked(from).binary_search(&to).is_ok();
        (!linked).then_some(Link { from, to, kind })
    }

    fn shows_too_little(&self, observation: &Observation) -> bool {
        observation.len() < self.settings.min_words
    }

    /// Of the frames that `place` learnt from, but for those this session has just sent, the one that
    /// matches best.
    fn best_match(
        &self,
        place: PlaceId,
        recognition: &Recognition,
        observation: &Observation,
        (current, session): (SessionId, &Session),
        archive: &dyn FrameArchive,
    ) -> Result<Option<Match>, FrameError> {
        let single_looks = self.recognizer.index().model().single_looks(observation);
        let mut best: Option<(f64, FrameId)> = None;
        for frame in self.frames_before_guard(place, current, session).take(MAX_COMPARED_FRAMES) {
            let Some(seen) = archive.observation(frame)? else { continue };
            let log_likelihood = single_looks.log_likelihood(&seen);
            if best.is_none_or(|(best, _)| log_likelihood > best) {
                best = Some((log_likelihood, frame));
            }
        }
        let posterior = &recognition.posterior;
        Ok(best.map(|(_, frame)| Match {
            place,
            posterior: posterior.places[place as usize],
            log_odds: posterior.log_odds(place),
            frame,
        }))
    }

    /// Frames that a place learnt from, latest first, but for those the session has just sent.
    fn frames_before_guard(
        &self,
        place: PlaceId,
        current: SessionId,
        session: &Session,
    ) -> impl Iterator<Item = FrameId> {
        let (guard_frames, frames) = (self.settings.guard_frames, session.frames);
        let is_earlier =
            move |frame: &&PlaceFrame| frame.session != current || frames - frame.number >= guard_frames;
        let of_place = self.map.places().get(place as usize).map_or(&[][..], |place| &place.frames);
        of_place.iter().rev().filter(is_earlier).map(|frame| frame.frame)
    }
}

/// Whether a frame may leave something behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Growth {
    Grows,
    ReadOnly,
}

impl Growth {
    /// A place that would be created is none where nothing grows.
    fn limit(self, decision: Decision) -> Decision {
        match (self, decision.reason) {
            (Growth::ReadOnly, Reason::NewPlace | Reason::BelowThreshold | Reason::GeometryRefused) => {
                Decision { place: None, ..decision }
            }
            (Growth::ReadOnly, Reason::SamePlace | Reason::LoopClosure | Reason::TooFewWords)
            | (Growth::Grows, _) => decision,
        }
    }
}

/// Frames of a place that one frame is compared with, the latest: a place learns a few a visit.
const MAX_COMPARED_FRAMES: usize = 32;

/// Frames at one place without a turn of the wheels that say nothing against them.
const STANDING_FRAMES: u64 = 30;
