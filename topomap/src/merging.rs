//! Two maps of the same places become one.
//!
//! [`pairs_to_compare`] looks for every place of one map on the other, by words, and names the pairs
//! of frames whose views are to be compared; the holder of keypoints compares them, and
//! [`find_matches`] says which are enough. [`judge`] chooses the largest set of matches that agree
//! with each other and says whether it is enough, or why not; [`join`] rewrites the source's log as
//! what happened on the target. All take values, none calls back or changes anything: the holder of
//! the logs commits.
//!
//! Wrong matches between two maps are no noise: offices that look alike agree with each other as
//! well as true ones do. So what is looked for is the largest set of pairwise consistent matches
//! (Mangelson et al., ICRA 2018) and not a robust minimum: graduated non-convexity has to start
//! from some transformation between the maps, and there is none; a set of matches can moreover be
//! compared with its rivals, which a minimum has not.

mod cliques;
mod consistency;
mod joining;
mod judgement;
mod layout;
mod matching;
mod steps;
mod ways;

use fabmap::appearance::PlaceId;

use crate::evidence::TwoView;
use crate::ids::FrameId;
use crate::log::{FrameEvent, MapEvent};
use crate::mapper::Mapper;
use crate::metric::RelativePose;
use posegraph::PlanarPose;

pub use joining::{JoinError, join};
pub use judgement::{joined_poses, judge};
pub use layout::Layout;
pub use matching::{find_matches, pairs_to_compare};

/// A map, and the log that made it.
#[derive(Clone, Copy)]
pub struct KnownMap<'a> {
    /// The map.
    pub mapper: &'a Mapper,
    /// Its log, from the first event on.
    pub log: &'a [MapEvent],
}

impl<'a> KnownMap<'a> {
    /// A frame; `None` if the log has none at that position.
    fn frame(&self, frame: FrameId) -> Option<&'a FrameEvent> {
        match self.log.get(usize::try_from(frame).ok()?)? {
            MapEvent::Frame(event) => Some(event),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
        }
    }
}

/// A place of the source that may be one of the target, by words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacePair {
    /// The place of the source.
    pub source: PlaceId,
    /// The place of the target.
    pub target: PlaceId,
    /// The frame that made the place of the source: the current view of the two to be compared.
    pub source_frame: FrameId,
    /// The frame of the target's place that explains its words best: the earlier view.
    pub target_frame: FrameId,
    /// Probability of the place of the target among all its places and "somewhere new".
    pub posterior: f64,
}

/// What comparing the two views of a [`PlacePair`] found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairComparison {
    /// `None` if one of the frames has no keypoints: words then decide alone.
    pub view: Option<TwoView>,
    /// Focal length of the camera of the source's frame along x, in image widths; `None` if its
    /// model is not known.
    pub focal_length_widths: Option<f64>,
}

/// Hears how far the search is, and may end it.
pub trait MergeObserver: Sync {
    /// So many of the source's places have been looked for; from several threads. False ends the
    /// search.
    fn goes_on(&self, places: usize) -> bool;
}

impl MergeObserver for () {
    fn goes_on(&self, _places: usize) -> bool {
        true
    }
}

/// What a merge has to show; see [`MergeSettings::check`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MergeSettings {
    /// Places of the target that a place of the source is compared with, 1 to 64.
    pub candidates: usize,
    /// Least [`TwoView::evidence`] of a match, at least 0.
    pub min_evidence: f64,
    /// Least matches that agree with each other, at least 3.
    pub min_support: usize,
    /// Least evidence of those together, at least 0: as a loop closure needs, whose frames add
    /// theirs up.
    pub min_total_evidence: f64,
    /// Largest share that the next best set of matches may have of the matches of the best, in [0,
    /// 1].
    pub max_rival_share: f64,
    /// Least share of the source's places that match where the maps then overlap, in [0, 1].
    pub min_confirmed_share: f64,
}

impl Default for MergeSettings {
    fn default() -> Self {
        Self {
            candidates: 4,
            min_evidence: 20.0,
            min_support: 5,
            min_total_evidence: 350.0,
            max_rival_share: 0.25,
            min_confirmed_share: 0.6,
        }
    }
}

/// A place of the source that looks like one of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceMatch {
    /// The place of the source.
    pub source: PlaceId,
    /// The place of the target.
    pub target: PlaceId,
    /// The frame of the source that was compared.
    pub source_frame: FrameId,
    /// With that frame of the target.
    pub target_frame: FrameId,
    /// Probability of the place of the target among all its places and "somewhere new", by words
    /// alone.
    pub posterior: f64,
    /// What geometry found; `None` where words decided alone.
    pub view: Option<TwoView>,
    /// Pose of the place of the source in the frame of the place of the target, if that was
    /// measured.
    pub measured: Option<RelativePose>,
}

/// What comes of two maps.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// They overlap.
    Overlap(MergePlan),
    /// They do not, as far as can be told.
    Apart(Apart),
}

/// How a source joins a target.
#[derive(Clone, Debug, PartialEq)]
pub struct MergePlan {
    /// The frame of the source's part in that of the target's; the identity where one of the maps
    /// knows no metres.
    pub transformation: PlanarPose,
    /// The lowest places of the two parts, source and target, that the transformation is between.
    pub parts: (PlaceId, PlaceId),
    /// Places of the source that become places of the target, ascending.
    pub fused: Vec<FusedPlace>,
    /// Matches that agree with each other and with both maps once they are one, strongest first.
    pub matches: Vec<PlaceMatch>,
    /// All others.
    pub rejected: Vec<PlaceMatch>,
    /// Matches of the next best set that contradicts these.
    pub rival_support: usize,
    /// Places of the source that lie where the target has places, too.
    pub overlap: Overlap,
    /// Sum of eᵀΩe over the links of both maps, each by itself.
    pub cost_before: f64,
    /// The same and of the matches, with both maps as one.
    pub cost_after: f64,
}

/// A place of the source that becomes one of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusedPlace {
    /// Of its matches that with the place that it lies nearest to.
    pub matched: PlaceMatch,
    /// Pose of the place of the source in the frame of that of the target, with both maps as one:
    /// what this match and all others say together. Where one of the maps knows no metres, only
    /// that it is somewhere near.
    pub at: RelativePose,
}

/// Where two maps lie over each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Overlap {
    /// Places of the source that lie where the target has one.
    pub places: usize,
    /// Those of them that match it, or a neighbour.
    pub confirmed: usize,
}

impl MergePlan {
    /// The same plan for a target that has grown since: by so many places beyond the first so many,
    /// and events likewise. What another merge was to add to the target by then comes after what
    /// has come in between.
    #[must_use]
    pub fn on_a_grown_target(
        mut self,
        (places, later_places): (PlaceId, u32),
        (events, later_events): (FrameId, FrameId),
    ) -> Self {
        let place = |place: &mut PlaceId| {
            if *place >= places {
                *place = place.counted_from(PlaceId::new(later_places));
            }
        };
        let fused = self.fused.iter_mut().map(|fused| &mut fused.matched);
        for matched in fused.chain(&mut self.matches).chain(&mut self.rejected) {
            place(&mut matched.target);
            matched.target_frame += if matched.target_frame < events { 0 } else { later_events };
        }
        place(&mut self.parts.1);
        self
    }
}

impl PlaceMatch {
    /// See [`TwoView::evidence`]; 0 where words decided alone.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        self.view.as_ref().map_or(0.0, TwoView::evidence)
    }
}

impl Overlap {
    /// The share of the places that match; 1 of none.
    #[must_use]
    pub fn confirmed_share(&self) -> f64 {
        if self.places == 0 { 1.0 } else { self.confirmed as f64 / self.places as f64 }
    }
}

/// Why two maps stay two.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Apart {
    /// The map that is to go into the other has no two places that are linked.
    #[error("it has no two places that are linked yet; drive on until it has some")]
    NothingMeasured,
    /// The map that others are to go into has none.
    #[error(
        "the map that it is to go into has no two places that are linked yet; drive in that one first, or name a target that \
         there is not yet: it is made of the maps"
    )]
    NothingToGoInto,
    /// Nothing looks alike.
    #[error("no place of the one looks like one of the other")]
    NoMatches,
    /// What looks alike does not agree with each other.
    #[error(
        "of {matches} matches no more than {support} agree with each other, which takes {required}; drive through more \
         of what both maps show, or lower the least support"
    )]
    TooLittleSupport {
        /// Matches.
        matches: usize,
        /// The most that agree.
        support: usize,
        /// What is asked for.
        required: usize,
    },
    /// What agrees is too little to be sure of.
    #[error("the {support} matches that agree have an evidence of {evidence:.0}, which takes {required:.0}")]
    TooLittleEvidence {
        /// Matches that agree.
        support: usize,
        /// Their evidence.
        evidence: f64,
        /// What is asked for.
        required: f64,
    },
    /// Two ways of laying one map over the other are as good as each other.
    #[error(
        "{support} matches lay one map over the other in one way, {rival} in another: they may be of places that look \
         alike"
    )]
    Ambiguous {
        /// Matches of the best.
        support: usize,
        /// Matches of the next.
        rival: usize,
    },
    /// Laid over each other, they show different things.
    #[error(
        "laid over the other map, {places} places lie where that has places, too, but only {confirmed} look alike",
        places = .0.places,
        confirmed = .0.confirmed
    )]
    Contradicted(Overlap),
}

/// A search that came to no end.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MergeError {
    /// The maps' words are of different vocabularies.
    #[error(
        "the maps have vocabularies of {source_words} and {target_words} words; rebuild one of them with the other's \
         model first"
    )]
    Vocabulary {
        /// Words of the source's.
        source_words: usize,
        /// Words of the target's.
        target_words: usize,
    },
    /// A setting is out of range.
    #[error("the merge's {setting} cannot be {value}; leave it out for the default")]
    Setting {
        /// Which.
        setting: &'static str,
        /// The value given.
        value: f64,
    },
    /// The observer has ended it.
    #[error("the search was ended before it had asked for all places")]
    Ended,
}

impl MergeSettings {
    /// # Errors
    /// [`MergeError::Setting`] if one is out of range.
    pub fn check(&self) -> Result<(), MergeError> {
        let share = 0.0..=1.0;
        let checks = [
            ("number of candidates", self.candidates as f64, (1..=64).contains(&self.candidates)),
            ("least evidence", self.min_evidence, self.min_evidence >= 0.0),
            ("least support", self.min_support as f64, self.min_support >= 3),
            ("least evidence of all matches", self.min_total_evidence, self.min_total_evidence >= 0.0),
            ("rival's largest share", self.max_rival_share, share.contains(&self.max_rival_share)),
            ("least confirmed share", self.min_confirmed_share, share.contains(&self.min_confirmed_share)),
        ];
        match checks.into_iter().find(|(_, _, fits)| !fits) {
            Some((setting, value, _)) => Err(MergeError::Setting { setting, value }),
            None => Ok(()),
        }
    }
}
