//! Systems under test: each is shown the frames in order and proposes one earlier frame for each.

mod fab_map;
mod likelihood;
mod tf_idf;

pub(crate) use fab_map::FabMap;
pub(crate) use likelihood::LikelihoodRanking;
pub(crate) use tf_idf::TfIdfRanking;

use anyhow::Result;
use fabmap::appearance::PlaceId;
use topomap::evidence::Candidate;
use topomap::log::Reason;

use crate::observing::Observed;
use crate::timing::{FrameWatch, StageTimes};

/// A system that recognises places.
pub(crate) trait Ranking {
    /// Takes the next frame, number `index`, and answers which earlier one shows the same place.
    fn rank(&mut self, index: usize, seen: Observed, watch: FrameWatch) -> Result<Ranked>;

    /// Places on the map; `None` for a system that has none.
    fn places(&self) -> Option<usize>;
}

/// The answer to one frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ranked {
    /// Different words that the frame shows.
    pub words: usize,
    /// The earlier frame that is most likely a loop, whatever was decided.
    pub proposal: Option<Proposal>,
    /// What was made of the frame; `None` for a system that only ranks.
    pub decision: Option<RankedDecision>,
    /// The earlier frames that it was compared with; none for a system that only ranks.
    pub candidates: Vec<RankedCandidate>,
    /// How well each frame before this one matches, in [0, 1]: the posterior of its place, or its
    /// cosine.
    pub similarities: Vec<f64>,
    /// How long it took.
    pub times: StageTimes,
}

/// An earlier frame with how sure the system is of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Proposal {
    /// Index of the earlier frame.
    pub frame: usize,
    /// What proposals are ordered by: the log-odds of the place's posterior, in nats, or the cosine; with
    /// geometry, [`topomap::evidence::Candidate::score`].
    pub score: f64,
    /// The posterior probability of its place; `None` for a system without probabilities.
    pub posterior: Option<f64>,
    /// That it is right, as the system reports it: its posterior, or that and geometry together.
    pub probability: Option<f64>,
}

/// An earlier frame that a frame was compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RankedCandidate {
    /// Index of the earlier frame.
    pub frame: usize,
    /// What speaks for it.
    pub candidate: Candidate,
}

/// What a system that maps decided about a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RankedDecision {
    /// Why.
    pub reason: Reason,
    /// The place that the frame belongs to.
    pub place: Option<PlaceId>,
    /// Posterior probability of what was decided.
    pub posterior: f64,
    /// p(new | Z).
    pub new_place_posterior: f64,
    /// For a loop closure, accepted or not: the frame that it closes with.
    pub closure: Option<Proposal>,
    /// Inliers of the proposal; `None` without geometry.
    pub inliers: Option<u32>,
}
