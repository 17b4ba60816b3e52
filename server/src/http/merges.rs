//! Maps that become one: looked for, seen and decided.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use topomap::relaxation::PlanarPose;
use utoipa::ToSchema;

use super::HttpError;
use super::description::Refusals;
use super::frames::{ImageFile, unless_known};
use super::geometry::Pose;
use super::parameters::{InPath, InQuery, MergePath, Nothing, Paging};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::merges::{
    self, MatchedPlaces, MergeReport, MergeRequest, MergeView, MergedSource, OnceFound, SourceOutcome,
};
use crate::service::models::Page;
use crate::service::names::map_name;
use crate::storage;

/// All merges, newest first.
#[utoipa::path(get, path = "/v1/merges", tag = "merges", params(Paging),
    responses((status = 200, description = "A page of merges.", body = MergeList), Refusals))]
pub(super) async fn list_merges(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<MergeList>, HttpError> {
    let Page { items, next } = service.list_merges(page_size, &page_token).await?;
    Ok(Json(MergeList { merges: items.into_iter().map(Merge::from).collect(), next_page_token: next }))
}

/// Begins to look for maps on each other; the job that does so is named in the answer. For administrators.
#[utoipa::path(post, path = "/v1/merges", tag = "merges",
    request_body(content = MergeMaps, description = "The maps, and what is to be done once an overlap is found."),
    responses((status = 200, description = "The merge.", body = Merge), Refusals))]
pub(super) async fn merge_maps(
    State(service): State<Arc<Service>>,
    InQuery(Nothing {}): InQuery<Nothing>,
    request: Result<Json<MergeMaps>, JsonRejection>,
) -> Result<Json<Merge>, HttpError> {
    let Json(MergeMaps { sources, target, once_found, min_support }) = request.map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; send {{\"sources\": [\"maps/A\", \"maps/B\"], \"target\": \"maps/C\"}} as application/json",
            rejection.body_text()
        ))
    })?;
    let once_found = match once_found {
        WhenFound::Propose => OnceFound::Propose,
        WhenFound::Commit => OnceFound::Commit,
    };
    let request = MergeRequest { sources, target, once_found, min_support };
    Ok(Json(service.merge_maps(request).await?.into()))
}

/// A merge as it stands.
#[utoipa::path(get, path = "/v1/merges/{merge}", tag = "merges", params(MergePath),
    responses((status = 200, description = "The merge.", body = Merge), Refusals))]
pub(super) async fn get_merge(
    State(service): State<Arc<Service>>,
    InPath(MergePath { merge }): InPath<MergePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Merge>, HttpError> {
    Ok(Json(service.merge(&format!("merges/{merge}")).await?.into()))
}

/// The maps before and after: trajectories blue, links within a session red, between sessions green.
#[utoipa::path(get, path = "/v1/merges/{merge}/picture", tag = "merges", params(MergePath,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the picture that is there already.")),
    responses(
        (status = 200, description = "The picture.", headers(("ETag" = String, description = "Hash of the picture.")),
            content((ImageFile = "image/svg+xml"))),
        (status = 304, description = "The picture is still the one that the caller has."),
        Refusals))]
pub(super) async fn get_merge_picture(
    State(service): State<Arc<Service>>,
    InPath(MergePath { merge }): InPath<MergePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let picture = service.merge_picture(&format!("merges/{merge}")).await?;
    unless_known(&headers, "image/svg+xml", picture.into_bytes()).await
}

/// Commits or discards what was proposed, or undoes what was committed. For administrators.
#[utoipa::path(put, path = "/v1/merges/{merge}/decision", tag = "merges", params(MergePath),
    request_body(content = Decision, description = "What is to become of it."),
    responses((status = 200, description = "The merge.", body = Merge), Refusals))]
pub(super) async fn decide_merge(
    State(service): State<Arc<Service>>,
    InPath(MergePath { merge }): InPath<MergePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    decision: Result<Json<Decision>, JsonRejection>,
) -> Result<Json<Merge>, HttpError> {
    let Json(Decision { decision }) = decision.map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; send {{\"decision\": \"commit\"}}, \"discard\" or \"undo\" as application/json",
            rejection.body_text()
        ))
    })?;
    let name = format!("merges/{merge}");
    let view = match decision {
        Decided::Commit => service.commit_merge(&name).await?,
        Decided::Discard => service.discard_merge(&name).await?,
        Decided::Undo => service.undo_merge(&name).await?,
    };
    Ok(Json(view.into()))
}

/// Maps that are to become one.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"sources": ["maps/monday", "maps/tuesday"], "target": "maps/office"}))]
pub(super) struct MergeMaps {
    /// `maps/{map}`, each once; at most 16 beside the target.
    sources: Vec<String>,
    /// `maps/{map}`. If there is no such map, it is made of the sources, and begins with the first of them.
    target: String,
    #[serde(default)]
    once_found: WhenFound,
    /// Least matches that agree with each other; 5 if left out.
    #[serde(default)]
    #[schema(minimum = 3)]
    min_support: Option<u32>,
}

/// Whether somebody decides, or every overlap that is found is committed.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum WhenFound {
    #[default]
    Propose,
    Commit,
}

/// What is to become of a merge.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"decision": "commit"}))]
pub(super) struct Decision {
    decision: Decided,
}

#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Decided {
    Commit,
    Discard,
    Undo,
}

/// A page of merges.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct MergeList {
    merges: Vec<Merge>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// Maps that become one, or do not.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Merge {
    /// `merges/{number}`
    name: String,
    state: MergeState,
    /// `maps/{map}`
    target: String,
    sources: Vec<MergeSource>,
    /// What works on it, or did last: `jobs/{number}`
    job: String,
    /// Why it failed and how to mend it.
    #[schema(required)]
    error: Option<String>,
    create_time_ns: i64,
}

/// `proposed` waits for a decision; `apart` means that at least one source does not overlap.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum MergeState {
    Searching,
    Proposed,
    Apart,
    Committed,
    Discarded,
    Undone,
    Failed,
}

/// A map that is to go into another.
#[derive(Debug, Serialize, ToSchema)]
struct MergeSource {
    /// `maps/{map}`
    map: String,
    /// Log events when it was looked at; what came later is not merged.
    events: u64,
    places: u64,
    /// Null if it does not overlap, or was not looked for yet.
    #[schema(required)]
    overlap: Option<MapOverlap>,
    /// Why it overlaps with nothing.
    #[schema(required)]
    apart: Option<String>,
    /// Its sessions, by the names that they have in the target; none before it is committed.
    sessions: Vec<String>,
}

/// How a source lies on the target.
#[derive(Debug, Serialize, ToSchema)]
struct MapOverlap {
    /// The frame of the source's part in that of the target's; null where one of the maps knows no metres.
    #[schema(required)]
    transformation: Option<Pose>,
    /// The lowest places of the parts that the transformation is between.
    source_part: u32,
    target_part: u32,
    /// Matches that agree with each other and with both maps, and all others.
    agreeing_matches: u64,
    rejected_matches: u64,
    /// Matches of the next best set, which contradicts these.
    rival_matches: u64,
    /// Places of the source that become places of the target.
    fused_places: u64,
    /// Places of the source that lie where the target has places, too, and those of them that match.
    overlapping_places: u64,
    confirmed_places: u64,
    /// Sum of squared errors of all links, in standard deviations: each map by itself, and both as one.
    cost_before: f64,
    cost_after: f64,
    /// The strongest of the matches that agree.
    #[schema(max_items = 500)]
    strongest_matches: Vec<PlaceMatch>,
}

/// A place of the source, and the one of the target that it is.
#[derive(Debug, Serialize, ToSchema)]
struct PlaceMatch {
    source_place: u32,
    target_place: u32,
    /// The frames that were compared: `maps/{map}/sessions/{session}/frames/{sequence}`
    source_frame: String,
    target_frame: String,
    /// By words alone, among all places of the target and "somewhere new".
    #[schema(minimum = 0, maximum = 1)]
    posterior: f64,
    /// By geometry, in nats; 0 where words decided alone.
    evidence_nats: f64,
}

impl From<MergeView> for Merge {
    fn from(view: MergeView) -> Self {
        let MergeView { number, target, job, state, report, error, created_ns } = view;
        // How a map was made is for its undoing.
        let MergeReport { sources, made_events: _ } = report;
        Self {
            name: format!("merges/{number}"),
            state: state.into(),
            target: map_name(&target),
            sources: sources.into_iter().map(MergeSource::from).collect(),
            job: format!("jobs/{job}"),
            error,
            create_time_ns: created_ns,
        }
    }
}

impl From<storage::MergeState> for MergeState {
    fn from(state: storage::MergeState) -> Self {
        match state {
            storage::MergeState::Searching => Self::Searching,
            storage::MergeState::Proposed => Self::Proposed,
            storage::MergeState::Apart => Self::Apart,
            storage::MergeState::Committed => Self::Committed,
            storage::MergeState::Discarded => Self::Discarded,
            storage::MergeState::Undone => Self::Undone,
            storage::MergeState::Failed => Self::Failed,
        }
    }
}

impl From<MergedSource> for MergeSource {
    fn from(source: MergedSource) -> Self {
        let MergedSource { map, events, places, outcome, sessions } = source;
        let (overlap, apart) = match outcome {
            SourceOutcome::Open => (None, None),
            SourceOutcome::Overlaps(overlap) => (Some((*overlap).into()), None),
            SourceOutcome::Apart(why) => (None, Some(why)),
        };
        Self { map: map_name(&map), events, places, overlap, apart, sessions }
    }
}

impl From<merges::MapOverlap> for MapOverlap {
    fn from(overlap: merges::MapOverlap) -> Self {
        let merges::MapOverlap {
            transformation,
            source_part,
            target_part,
            agreeing,
            rejected,
            rival_support,
            fused_places,
            overlapping_places,
            confirmed_places,
            cost_before,
            cost_after,
            strongest,
        } = overlap;
        let matched = |matched: MatchedPlaces| {
            let MatchedPlaces { source_place, target_place, source_frame, target_frame, posterior, evidence } =
                matched;
            let evidence_nats = evidence;
            PlaceMatch { source_place, target_place, source_frame, target_frame, posterior, evidence_nats }
        };
        Self {
            transformation: transformation
                .map(|[x_m, y_m, heading_rad]| PlanarPose::new(x_m, y_m, heading_rad).on_the_ground().into()),
            source_part,
            target_part,
            agreeing_matches: agreeing,
            rejected_matches: rejected,
            rival_matches: rival_support,
            fused_places,
            overlapping_places,
            confirmed_places,
            cost_before,
            cost_after,
            strongest_matches: strongest.into_iter().map(matched).collect(),
        }
    }
}
