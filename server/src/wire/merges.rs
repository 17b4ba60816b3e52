//! Merges as messages.

use posegraph::PlanarPose;
use waypost_proto::v1;
use waypost_proto::v1::merge_source::Outcome;

use super::geometry::planar_pose;
use super::status::as_message;
use crate::names::map_name;
use crate::service::merges::MergeState;
use crate::service::merges::{
    MapOverlap, MatchedPlaces, MergeReport, MergeView, MergedSource, SourceOutcome,
};

pub(crate) fn merge(view: MergeView) -> v1::Merge {
    use v1::merge::State;
    let MergeView { number, target, job, state, report, error, created_ns } = view;
    // How a map was made is for its undoing.
    let MergeReport { base, sources, made_events: _ } = report;
    let state = match state {
        MergeState::Searching => State::Searching,
        MergeState::Proposed => State::Proposed,
        MergeState::NoOverlap => State::NoOverlap,
        MergeState::Committed => State::Committed,
        MergeState::Discarded => State::Discarded,
        MergeState::Undone => State::Undone,
        MergeState::Failed => State::Failed,
    };
    v1::Merge {
        name: format!("merges/{number}"),
        state: state.into(),
        target: map_name(&target),
        base: base.map(source),
        sources: sources.into_iter().map(source).collect(),
        job: format!("jobs/{job}"),
        error: error.as_ref().map(as_message),
        create_time_ns: created_ns,
    }
}

fn source(source: MergedSource) -> v1::MergeSource {
    let MergedSource { map, events, places, outcome, sessions } = source;
    let outcome = match outcome {
        SourceOutcome::Open => None,
        SourceOutcome::Overlaps(found) => Some(Outcome::Overlap(overlap(*found))),
        SourceOutcome::NoOverlap(why) => Some(Outcome::NoOverlapReason(why)),
    };
    v1::MergeSource { map: map_name(&map), events, places, outcome, sessions }
}

fn overlap(overlap: MapOverlap) -> v1::MapOverlap {
    let MapOverlap {
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
        let MatchedPlaces {
            source_place,
            target_place,
            source_frame,
            target_frame,
            source_note,
            target_note,
            posterior,
            evidence,
        } = matched;
        v1::PlaceMatch {
            source_place_number: source_place,
            target_place_number: target_place,
            source_frame,
            target_frame,
            source_note,
            target_note,
            posterior,
            // Words alone leave no evidence.
            evidence_inliers: (evidence > 0.0).then_some(evidence),
        }
    };
    v1::MapOverlap {
        transformation: transformation
            .map(|[x_m, y_m, heading_rad]| planar_pose(&PlanarPose::new(x_m, y_m, heading_rad))),
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
