//! What was recognised and why, as messages.

use fabmap::explanation::{Explanation, WordEvidence};
use topomap::evidence::{Placement, Similarity};
use topomap::log::Reason;
use topomap::mapper::Gate;
use topomap::metric::Agreement;
use waypost_proto::v1;

use super::corrections::correction;
use super::geometry::planar_pose;
use super::references::frame_reference;
use crate::open_map::answers::{GeometryView, MatchView, QueryAnswer};
use crate::service::queries::{FrameExplanation, GateView, OdometryAgreement};

pub(crate) fn query_response(answer: QueryAnswer) -> v1::QueryResponse {
    let QueryAnswer { places, new_place_posterior, matched, accepted, words, explanation } = answer;
    let places = places.into_iter().map(|(place_number, posterior)| v1::PlaceProbability {
        place_number: place_number.number(),
        posterior,
    });
    v1::QueryResponse {
        places: places.collect(),
        new_place_posterior,
        r#match: matched.map(found),
        accepted,
        words: u32::try_from(words).unwrap_or(u32::MAX),
        place_explanation: explanation.map(place_explanation),
    }
}

pub(crate) fn reason_code(reason: Reason) -> v1::Reason {
    match reason {
        Reason::NewPlace => v1::Reason::NewPlace,
        Reason::SamePlace => v1::Reason::SamePlace,
        Reason::LoopClosure => v1::Reason::LoopClosure,
        Reason::BelowThreshold => v1::Reason::BelowThreshold,
        Reason::TooFewWords => v1::Reason::TooFewWords,
        Reason::GeometryRefused => v1::Reason::GeometryRefused,
    }
}

pub(crate) fn found(found: MatchView) -> v1::Match {
    let MatchView { place, posterior, log_odds, frame, geometry } = found;
    let geometry = geometry.map(geometry_message);
    v1::Match {
        place_number: place.number(),
        posterior,
        log_odds,
        frame: Some(frame_reference(frame)),
        geometry,
    }
}

fn geometry_message(geometry: GeometryView) -> v1::Geometry {
    let GeometryView { matches, inliers, evidence, look_alikes, probability, similarity, placement } =
        geometry;
    let similarity = similarity.map(|similarity| {
        let Similarity { rotation_rad, ln_scale, translation_widths: [x_widths, y_widths] } = similarity;
        v1::Similarity { rotation_rad, ln_scale, x_widths, y_widths }
    });
    let placement = placement_message(&placement);
    v1::Geometry {
        matches,
        inliers,
        evidence_inliers: evidence,
        similarity,
        probability,
        placement,
        look_alike_inliers: look_alikes,
    }
}

fn placement_message(placement: &Placement) -> Option<v1::Placement> {
    match placement {
        Placement::Unknown => None,
        Placement::Nowhere => Some(v1::Placement::default()),
        Placement::At { pose, inliers } => Some(v1::Placement {
            pose: Some(planar_pose(pose.pose())),
            covariance: pose.covariance().transpose().iter().copied().collect(),
            inliers: *inliers,
        }),
    }
}

pub(crate) fn explanation(explanation: FrameExplanation) -> v1::FrameExplanation {
    let FrameExplanation { name, reason, gates, place, reproduced, picture, odometry, corrections } =
        explanation;
    v1::FrameExplanation {
        name,
        reason: reason_code(reason).into(),
        gates: gates.into_iter().map(gate).collect(),
        place_explanation: place.map(place_explanation),
        reproduced,
        picture,
        odometry_agreement: odometry.map(odometry_agreement),
        corrections: corrections.into_iter().map(correction).collect(),
    }
}

fn odometry_agreement(agreement: OdometryAgreement) -> v1::OdometryAgreement {
    let OdometryAgreement { turns, ways, finding } = agreement;
    v1::OdometryAgreement { turns: turns.map(ratio), ways: ways.map(ratio), finding }
}

fn ratio(agreement: Agreement) -> v1::OdometryRatio {
    let Agreement { compared, ratio, spread } = agreement;
    v1::OdometryRatio { compared: u32::try_from(compared).unwrap_or(u32::MAX), ratio, spread }
}

fn gate(view: GateView) -> v1::Gate {
    let GateView { name, gate, description } = view;
    let Gate { passed, value, required } = gate;
    v1::Gate { name: name.to_owned(), passed, value, required, description }
}

fn place_explanation(explanation: Explanation) -> v1::PlaceExplanation {
    let Explanation {
        place,
        prior,
        posterior,
        new_place_posterior,
        log_likelihood,
        new_place_log_likelihood,
        // The map's settings say it.
        new_place_method: _,
        average_place_log_likelihood,
        words_for,
        words_against,
        other_words_nats,
    } = explanation;
    v1::PlaceExplanation {
        place_number: place.number(),
        prior,
        posterior,
        new_place_posterior,
        log_likelihood,
        new_place_log_likelihood,
        average_place_log_likelihood,
        words_for: words_for.into_iter().map(evidence).collect(),
        words_against: words_against.into_iter().map(evidence).collect(),
        other_words_evidence_nats: other_words_nats,
    }
}

fn evidence(evidence: WordEvidence) -> v1::WordEvidence {
    let WordEvidence { word, seen, hits, looks, nats } = evidence;
    v1::WordEvidence { word: word.into(), seen, hits: hits.into(), looks: looks.into(), evidence_nats: nats }
}
