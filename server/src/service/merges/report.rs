//! What was found out about maps that are to become one; kept as JSON beside the merge.

use serde::{Deserialize, Serialize};
use topomap::merging::{MergePlan, Overlap, PlaceMatch};

use crate::error::ServiceError;
use crate::service::read_map::ToldFrame;
use crate::storage::MapRow;

/// Matches that are told of, the strongest.
const MOST_TOLD: usize = 500;

/// All that is known of a merge.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct MergeReport {
    /// The first source, where the target is made as a copy of it; its outcome stays open. Older merges do not say.
    #[serde(default)]
    pub(crate) base: Option<MergedSource>,
    /// The others, or all where the target was there before.
    pub(crate) sources: Vec<MergedSource>,
    /// Events of the log of the map that the merge has made; `None` if the map was there before.
    pub(crate) made_events: Option<u64>,
}

/// A map that is to go into another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct MergedSource {
    pub(crate) map: String,
    /// Log events when it was looked at: what came later is not merged.
    pub(crate) events: u64,
    pub(crate) places: u64,
    pub(crate) outcome: SourceOutcome,
    /// Its sessions, by the names that they have in the target; empty before it is committed.
    pub(crate) sessions: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum SourceOutcome {
    /// It was not looked for yet.
    Open,
    Overlaps(Box<MapOverlap>),
    /// It overlaps with nothing, as far as can be told: why.
    #[serde(rename = "apart")]
    NoOverlap(String),
}

/// How a source lies on the target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct MapOverlap {
    /// The frame of the source's part in that of the target's: x and y in metres, heading in radians. `None` where one of
    /// the maps knows no metres.
    pub(crate) transformation: Option<[f64; 3]>,
    /// The lowest places of the parts that the transformation is between.
    pub(crate) source_part: u32,
    pub(crate) target_part: u32,
    /// Matches that agree with each other and with both maps.
    pub(crate) agreeing: u64,
    pub(crate) rejected: u64,
    /// Matches of the next best set, which contradicts these.
    pub(crate) rival_support: u64,
    /// Places of the source that become places of the target.
    pub(crate) fused_places: u64,
    /// Places of the source that lie where the target has places, too, and those of them that match.
    pub(crate) overlapping_places: u64,
    pub(crate) confirmed_places: u64,
    pub(crate) cost_before: f64,
    pub(crate) cost_after: f64,
    /// The strongest of the matches that agree.
    pub(crate) strongest: Vec<MatchedPlaces>,
}

/// A place of the source, and the one of the target that it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct MatchedPlaces {
    pub(crate) source_place: u32,
    pub(crate) target_place: u32,
    /// The frames that were compared: `maps/{map}/sessions/{session}/frames/{sequence}`.
    pub(crate) source_frame: String,
    pub(crate) target_frame: String,
    /// What their robots call the two frames; empty if nothing, and in merges that older servers kept.
    #[serde(default)]
    pub(crate) source_note: String,
    #[serde(default)]
    pub(crate) target_note: String,
    /// By words alone, among all places of the target and "somewhere new".
    pub(crate) posterior: f64,
    /// By geometry, in nats; 0 where words decided alone.
    pub(crate) evidence: f64,
}

/// Whether both maps know metres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Metres {
    Known,
    Unknown,
}

impl MergeReport {
    /// Of maps that nobody has looked at yet. `base` is the source that a new target is to be a copy of.
    pub(super) fn asked(base: Option<&MapRow>, sources: &[MapRow]) -> Self {
        let source = |row: &MapRow| MergedSource {
            map: row.name.clone(),
            events: 0,
            places: 0,
            outcome: SourceOutcome::Open,
            sessions: Vec::new(),
        };
        Self { base: base.map(source), sources: sources.iter().map(source).collect(), made_events: None }
    }

    /// The names of the maps that go into the target.
    pub(super) fn maps(&self) -> impl Iterator<Item = &str> {
        self.base.iter().chain(&self.sources).map(|source| source.map.as_str())
    }

    /// Whether every source overlaps.
    pub(super) fn all_overlap(&self) -> bool {
        self.sources.iter().all(|source| matches!(source.outcome, SourceOutcome::Overlaps(_)))
    }

    pub(super) fn to_json(&self) -> Result<String, ServiceError> {
        serde_json::to_string(self).map_err(ServiceError::internal)
    }

    pub(super) fn from_json(json: &str) -> Result<Self, ServiceError> {
        serde_json::from_str(json).map_err(ServiceError::internal)
    }
}

impl MapOverlap {
    /// How a source with metres, or without, joins a target. `frames` names the frame of the source and that of the
    /// target.
    pub(super) fn of(
        plan: &MergePlan,
        metres: Metres,
        frames: impl Fn(&PlaceMatch) -> Result<[ToldFrame; 2], ServiceError>,
    ) -> Result<Self, ServiceError> {
        let MergePlan {
            transformation,
            parts: (source_part, target_part),
            fused,
            matches,
            rejected,
            rival_support,
            overlap: Overlap { places, confirmed },
            cost_before,
            cost_after,
        } = plan;
        let told = |matched: &PlaceMatch| {
            let [source, target] = frames(matched)?;
            Ok(MatchedPlaces {
                source_place: matched.source.number(),
                target_place: matched.target.number(),
                source_frame: source.name,
                target_frame: target.name,
                source_note: source.note,
                target_note: target.note,
                posterior: matched.posterior,
                evidence: matched.evidence(),
            })
        };
        let strongest: Result<Vec<MatchedPlaces>, ServiceError> =
            matches.iter().take(MOST_TOLD).map(told).collect();
        Ok(Self {
            transformation: match metres {
                Metres::Known => {
                    Some([transformation.x_m(), transformation.y_m(), transformation.heading_rad()])
                }
                Metres::Unknown => None,
            },
            source_part: source_part.number(),
            target_part: target_part.number(),
            agreeing: matches.len() as u64,
            rejected: rejected.len() as u64,
            rival_support: *rival_support as u64,
            fused_places: fused.len() as u64,
            overlapping_places: *places as u64,
            confirmed_places: *confirmed as u64,
            cost_before: *cost_before,
            cost_after: *cost_after,
            strongest: strongest?,
        })
    }
}

/// Why a merge failed that was not decided when the server stopped.
pub(super) fn forgotten() -> ServiceError {
    ServiceError::aborted(
        "the server was stopped or restarted before this was decided; it has changed nothing, so ask for it again",
    )
}
