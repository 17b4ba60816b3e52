//! Sessions, frames, queries and explanations as messages.

use fabmap::explanation::{Explanation, WordEvidence};
use prost::Message;
use topomap::mapper::Gate;
use waypost_proto::v1;

use super::convert::odometry_message;
use super::sessions::{answer, found, reason_code};
use crate::error::ServiceError;
use crate::service::frames::{FrameBytes, FrameView, SessionView};
use crate::service::queries::{FrameExplanation, GateView, QueryAnswer};
use crate::storage::SessionSummary;

pub(super) fn session(view: SessionView) -> Result<v1::Session, ServiceError> {
    let SessionView { name, summary } = view;
    let SessionSummary {
        number: _,
        name: _,
        camera,
        opened_ns,
        frames,
        loop_closures,
        first_sequence,
        last_sequence,
        first_stamp_ns,
        last_stamp_ns,
    } = summary;
    let camera = camera.map(|camera| v1::Camera::decode(camera.as_slice()));
    Ok(v1::Session {
        name,
        create_time_ns: opened_ns,
        camera: camera.transpose().map_err(ServiceError::internal)?,
        frames,
        loop_closures,
        first_sequence,
        last_sequence,
        first_stamp_ns,
        last_stamp_ns,
    })
}

pub(super) fn frame(view: FrameView) -> v1::FrameRecord {
    let FrameView { name, stamp_ns, answer: told, odometry, learnt, observation, bytes } = view;
    let FrameBytes { log, features, thumbnail, image } = bytes;
    let (words, counts) = observation.word_counts().unzip();
    v1::FrameRecord {
        name,
        stamp_ns,
        answer: Some(v1::FrameAnswer { resent: false, ..answer(told) }),
        odometry: odometry.as_ref().map(odometry_message),
        learnt,
        storage: Some(v1::FrameStorage {
            log_bytes: log,
            features_bytes: features,
            thumbnail_bytes: thumbnail,
            image_bytes: image,
        }),
        histogram: Some(v1::WordHistogram { words, counts }),
    }
}

pub(super) fn query_response(answer: QueryAnswer) -> v1::QueryResponse {
    let QueryAnswer { places, new_place_posterior, matched, accepted, words, explanation } = answer;
    let places = places.into_iter().map(|(place, posterior)| v1::PlaceProbability { place, posterior });
    v1::QueryResponse {
        places: places.collect(),
        new_place_posterior,
        r#match: matched.map(found),
        accepted,
        words: u32::try_from(words).unwrap_or(u32::MAX),
        explanation: explanation.map(place_explanation),
    }
}

pub(super) fn explanation(explanation: FrameExplanation) -> v1::FrameExplanation {
    let FrameExplanation { name, reason, gates, place, reproduced, picture } = explanation;
    v1::FrameExplanation {
        name,
        reason: reason_code(reason).into(),
        gates: gates.into_iter().map(gate).collect(),
        place: place.map(place_explanation),
        reproduced,
        picture,
    }
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
        place,
        prior,
        posterior,
        new_place_posterior,
        log_likelihood,
        new_place_log_likelihood,
        average_place_log_likelihood,
        words_for: words_for.into_iter().map(evidence).collect(),
        words_against: words_against.into_iter().map(evidence).collect(),
        other_words_nats,
    }
}

fn evidence(evidence: WordEvidence) -> v1::WordEvidence {
    let WordEvidence { word, seen, hits, looks, nats } = evidence;
    v1::WordEvidence { word, seen, hits: hits.into(), looks: looks.into(), nats }
}
