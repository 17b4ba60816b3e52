//! Where a robot is, without the map learning anything from it.

use fabmap::recognizer::Recognition;

use super::poses::MapPose;
use super::state::Mapper;
use crate::evidence::{Candidate, Match};
use crate::ids::SessionId;
use crate::log::FrameEvent;
use crate::map::Session;

/// A run of a robot that only looks: what is remembered between its frames, outside the log.
#[derive(Clone, Debug, PartialEq)]
pub struct Localizer {
    pub(super) session: Session,
}

/// Where one observation was made, if every place is as likely beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct Queried {
    /// Likelihoods, prior and posterior behind it.
    pub recognition: Recognition,
    /// What geometry was asked about; empty where nothing is verified.
    pub candidates: Vec<Candidate>,
    /// Of the most probable place, or of the one that geometry has most evidence for, the frame
    /// that matches best; none if the map is empty or too little was seen.
    pub matched: Option<Match>,
    /// Whether the match is more probable than a new place and reaches the map's threshold; with
    /// geometry, whether it was verified.
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

    /// Takes in what was decided of the frame after [`Mapper::localize`].
    pub fn follow(&mut self, event: &FrameEvent, mapper: &Mapper) {
        let odometry = event.odometry.as_ref();
        let sightings = mapper.sightings(self.session.frames, &event.candidates, odometry);
        self.session.follow(event, mapper.settings(), sightings);
    }
}

impl Default for Localizer {
    fn default() -> Self {
        Self::new()
    }
}
