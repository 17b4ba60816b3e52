//! What a map answers, as people and robots read it.

use fabmap::appearance::PlaceId;
use fabmap::explanation::Explanation;
use fabmap::observation::WordId;
use posegraph::PlanarPose;
use topomap::evidence::{Candidate, Match, Placement, Similarity, TwoView, ViewMotion};
use topomap::ids::{FrameId, SessionId};
use topomap::log::{FrameEvent, Reason};
use topomap::mapper::MapPose;

use crate::metrics::FrameTimings;
use crate::names::session_name;
use crate::storage::{SessionRow, StoredFrame};

/// Most places that an answer lists.
pub(super) const ANSWERED_PLACES: usize = 10;

/// The answer to a frame that is durable.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameAnswer {
    pub(crate) sequence: u64,
    pub(crate) last_committed: u64,
    pub(crate) reason: Reason,
    pub(crate) place: Option<PlaceId>,
    pub(crate) posterior: f64,
    pub(crate) new_place_posterior: f64,
    /// The most probable places, most probable first.
    pub(crate) places: Vec<(PlaceId, f64)>,
    pub(crate) closure: Option<MatchView>,
    pub(crate) proposal: Option<MatchView>,
    pub(crate) words: u64,
    /// `None` if the answer comes from the store.
    pub(crate) timings: Option<FrameTimings>,
    /// Where the robot is on the map, if that is known; `None` if the answer comes from the store.
    pub(crate) map_pose: Option<MapPose>,
}

/// What the places of a map learnt from, in no order, and the links that stand.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct PlaceGraph {
    pub(crate) looks: Vec<(SessionId, FrameId, PlaceId)>,
    pub(crate) links: Vec<(PlaceId, PlaceId)>,
}

/// An earlier frame of a place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatchView {
    pub(crate) place: PlaceId,
    pub(crate) posterior: f64,
    pub(crate) log_odds: f64,
    pub(crate) frame: FrameReference,
    /// `None` where geometry was not asked.
    pub(crate) geometry: Option<GeometryView>,
}

/// What geometry found between a frame and one that it matched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GeometryView {
    pub(crate) matches: u32,
    pub(crate) inliers: u32,
    /// In inliers, with what the frames before say.
    pub(crate) evidence: f64,
    /// What look-alikes are expected to show over the same frames, in inliers.
    pub(crate) look_alikes: f64,
    /// That both show the same place, by words and geometry together.
    pub(crate) probability: f64,
    pub(crate) similarity: Option<Similarity>,
    pub(crate) placement: Placement,
}

/// A frame by its session and number.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameReference {
    /// `maps/{map}/sessions/{session}`.
    pub(crate) session: String,
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    /// What its robot calls it; empty if nothing.
    pub(crate) note: String,
}

/// Where one observation was made.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct QueryAnswer {
    /// The most probable places, most probable first.
    pub(crate) places: Vec<(PlaceId, f64)>,
    pub(crate) new_place_posterior: f64,
    pub(crate) matched: Option<MatchView>,
    pub(crate) accepted: bool,
    pub(crate) words: u64,
    pub(crate) explanation: Option<Explanation>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PlaceSummary {
    pub(crate) place: PlaceId,
    pub(crate) looks: u8,
    /// Ascending by word.
    pub(crate) word_hits: Vec<(WordId, u8)>,
    pub(crate) frames: Vec<FrameId>,
    pub(crate) linked: Vec<PlaceId>,
    pub(crate) pose: Option<PlacePose>,
}

/// Where a place is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlacePose {
    /// The lowest place of its part, whose frame the pose is in.
    pub(crate) part: PlaceId,
    pub(crate) pose: PlanarPose,
}

/// A place that has shown a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct WordPlace {
    pub(crate) place: PlaceId,
    pub(crate) hits: u8,
    pub(crate) looks: u8,
}

impl FrameAnswer {
    /// The answer to a frame, all from its event, so that a stored one is the same.
    pub(crate) fn new(
        event: &FrameEvent,
        last_committed: u64,
        closure: Option<MatchView>,
        proposal: Option<MatchView>,
        timings: Option<FrameTimings>,
    ) -> Self {
        let decision = &event.decision;
        let created = match decision.reason {
            Reason::NewPlace | Reason::BelowThreshold | Reason::GeometryRefused => decision.place,
            Reason::SamePlace | Reason::LoopClosure | Reason::TooFewWords => None,
        };
        let mut places: Vec<(PlaceId, f64)> =
            event.belief.places.iter().copied().filter(|&(place, _)| Some(place) != created).collect();
        places.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        places.truncate(ANSWERED_PLACES);
        Self {
            sequence: event.sequence,
            last_committed,
            reason: decision.reason,
            place: decision.place,
            posterior: decision.posterior,
            new_place_posterior: event.new_place_posterior,
            places,
            closure,
            proposal,
            words: event.observation.len() as u64,
            timings,
            map_pose: None,
        }
    }
}

impl GeometryView {
    /// What was found for `matched`, if it is among the candidates.
    pub(crate) fn of(matched: Match, candidates: &[Candidate]) -> Option<Self> {
        let candidate = candidates.iter().find(|candidate| candidate.matched.frame == matched.frame)?;
        let TwoView { matches, inliers, distinct_inliers: _, motion, placement } = candidate.view?;
        let similarity = match motion {
            Some(ViewMotion::Similarity(similarity)) => Some(similarity),
            Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) | None => None,
        };
        let evidence = candidate.evidence();
        let probability = candidate.probability();
        let look_alikes = candidate.look_alike_inliers;
        Some(Self { matches, inliers, evidence, look_alikes, probability, similarity, placement })
    }
}

pub(crate) fn reference(map: &str, sessions: &[SessionRow], frame: &StoredFrame) -> FrameReference {
    let session = sessions.iter().find(|session| session.number == frame.session);
    FrameReference {
        session: session.map_or_else(String::new, |session| session_name(map, &session.name)),
        sequence: frame.sequence,
        stamp_ns: frame.stamp_ns,
        note: frame.note.clone(),
    }
}
