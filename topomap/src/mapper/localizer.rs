//! Where a robot is, without the map learning anything from it.

use fabmap::observation::Observation;
use fabmap::place_filter::MotionPrior;
use fabmap::recognizer::{Association, Recognition, Stage, StageObserver};

use super::{Decided, FrameArchive, FrameError, FrameInput, Growth, MapPose, Mapper, candidates};
use crate::event::{FrameEvent, Match, SessionId};
use crate::map::Session;
use crate::verification::{Candidate, Views};

/// A run of a robot that only looks: what is remembered between its frames, outside the log.
#[derive(Clone, Debug, PartialEq)]
pub struct Localizer {
    session: Session,
}

/// Where one observation was made, if every place is as likely beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct Queried {
    /// Likelihoods, prior and posterior behind it.
    pub recognition: Recognition,
    /// What geometry was asked about; empty where nothing is verified.
    pub candidates: Vec<Candidate>,
    /// Of the most probable place, or of the one that geometry has most evidence for, the frame that matches
    /// best; none if the map is empty or too little was seen.
    pub matched: Option<Match>,
    /// Whether the match is more probable than a new place and reaches the map's threshold; with geometry,
    /// whether it was verified.
    pub accepted: bool,
}

impl Localizer {
    /// Stands for the session of a frame that is none of the log.
    pub const SESSION: SessionId = SessionId::MAX;

    /// A robot that may be anywhere.
    #[must_use]
    pub fn new() -> Self {
        Self { session: Session::new() }
    }

    /// Sequence number of the last frame.
    #[must_use]
    pub fn last_sequence(&self) -> Option<u64> {
        self.session.last_sequence
    }

    /// Where the robot was at the last frame that wheels and a place tell it of.
    #[must_use]
    pub fn map_pose(&self, mapper: &Mapper) -> Option<MapPose> {
        mapper.map_pose(&self.session)
    }

    /// Takes in what [`Mapper::localize`] decided.
    pub fn follow(&mut self, event: &FrameEvent, mapper: &Mapper) {
        let sightings = mapper.sightings(self.session.frames, &event.candidates);
        self.session.follow(event, mapper.settings(), sightings);
    }
}

impl Default for Localizer {
    fn default() -> Self {
        Self::new()
    }
}

impl Mapper {
    /// Decides what a frame is as [`Mapper::decide`] does, but for a robot that leaves nothing behind: no
    /// place is created or learnt, no link added. The event is not one for the log; it is what
    /// [`Localizer::follow`] goes on from.
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be taken.
    pub fn localize(
        &self,
        localizer: &Localizer,
        input: FrameInput,
        archive: &dyn FrameArchive,
        views: &dyn Views,
        observer: &mut dyn StageObserver,
    ) -> Result<Decided, FrameError> {
        self.decide_within(Growth::ReadOnly, &localizer.session, input, (archive, views), observer)
    }

    /// Where one observation was made, by appearance and, if the map's settings ask for it, geometry.
    ///
    /// # Errors
    /// [`FrameError::ForeignWord`], or [`FrameError::Archive`] if an earlier frame cannot be read.
    pub fn query(
        &self,
        observation: &Observation,
        archive: &dyn FrameArchive,
        views: &dyn Views,
        observer: &mut dyn StageObserver,
    ) -> Result<Queried, FrameError> {
        self.check_words(observation)?;
        let recognition = self.recognizer.recognize(observation, &MotionPrior::even(), observer);
        let (session, anyone) = (Localizer::SESSION, Session::new());
        let candidates = self.compare(observation, (session, &anyone), &recognition, archive, views)?;
        if self.verifies() {
            observer.completed(Stage::Verification);
        }
        let verified = self.verified(&anyone, &candidates);
        let candidate = verified.or_else(|| candidates::most_likely(&candidates));
        let matched = match (candidate, recognition.posterior.best_place()) {
            (Some(candidate), _) => Some(candidate.matched),
            (None, Some((place, _))) if !self.shows_too_little(observation) => {
                self.best_match(place, &recognition, observation, (session, &anyone), archive)?
            }
            (None, Some(_) | None) => None,
        };
        let by_words = |matched: Match| {
            recognition.association() == Association::Seen(matched.place)
                && matched.posterior >= self.settings.closure_threshold
                && (!self.verifies() || candidates::is_without_keypoints(&candidates, matched.place))
        };
        let accepted = verified.is_some() || matched.is_some_and(by_words);
        Ok(Queried { recognition, candidates, matched, accepted })
    }
}
