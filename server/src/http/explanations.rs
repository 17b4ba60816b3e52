use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use fabmap::explanation;
use serde::{Deserialize, Serialize};
use topomap::mapper;
use utoipa::{IntoParams, ToSchema};

use super::HttpError;
use super::description::Refusals;
use super::frames::Reason;
use super::parameters::{FramePath, InPath, InQuery, Parameters};
use crate::service::Service;
use crate::service::queries::{self, GateView};

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Asked {
    /// Number of the place to explain; left out, the one that was, or could have been, matched.
    place: Option<u32>,
    /// So many words for and as many against; 0 asks for the default.
    #[param(minimum = 0, maximum = 100, default = 10)]
    words: u32,
}

impl Parameters for Asked {
    const TAKES: &str = "place=NUMBER and words=NUMBER";
}

/// Why a frame was decided as it was.
///
/// The map is replayed up to it, so a late frame of a long map takes a while.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}/explanation", tag = "sessions",
    params(FramePath, Asked),
    responses((status = 200, description = "The explanation.", body = FrameExplanation), Refusals))]
pub(super) async fn explain_frame(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(Asked { place, words }): InQuery<Asked>,
) -> Result<Json<FrameExplanation>, HttpError> {
    Ok(Json(service.explain_frame(&path.name(), place, words).await?.into()))
}

/// Why a frame was decided as it was.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FrameExplanation {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`
    name: String,
    reason: Reason,
    /// What the frame had to pass to close a loop, in the order of checking.
    gates: Vec<Gate>,
    /// Why the place got its posterior; null if there was no place yet.
    #[schema(required)]
    place: Option<PlaceExplanation>,
    /// Whether the replay came to the logged posteriors to the bit. If not, another build or processor, or a
    /// model that is gone, had decided; the logged values hold.
    reproduced: bool,
    /// Path of the frame beside the place, as a picture; null if there was no place yet.
    #[schema(required, example = "/v1/maps/demo/sessions/monday/frames/7/picture?place=3")]
    picture: Option<String>,
}

/// A condition for a loop closure.
#[derive(Debug, Serialize, ToSchema)]
struct Gate {
    /// `words`, `known_place`, `guard` or `threshold`
    name: String,
    passed: bool,
    /// What was found.
    value: f64,
    /// What was asked for.
    required: f64,
    /// The same in a sentence.
    description: String,
}

/// Why a place got its posterior.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct PlaceExplanation {
    place: u32,
    prior: f64,
    posterior: f64,
    new_place_posterior: f64,
    /// ln p(Z | place), nats.
    log_likelihood: f64,
    /// ln p(Z | new place), nats, by the map's method.
    new_place_log_likelihood: f64,
    /// ln p(Z | average place), nats: what the words below are compared with.
    average_place_log_likelihood: f64,
    /// Strongest first.
    words_for: Vec<WordEvidence>,
    /// Strongest first.
    words_against: Vec<WordEvidence>,
    /// Sum over the words not listed, nats.
    other_words_nats: f64,
}

/// What one word says for (above 0) or against a place.
#[derive(Debug, Serialize, ToSchema)]
struct WordEvidence {
    word: u32,
    /// Whether the frame shows it.
    seen: bool,
    /// How often the place showed it, in how many looks.
    hits: u8,
    looks: u8,
    nats: f64,
}

impl From<queries::FrameExplanation> for FrameExplanation {
    fn from(explanation: queries::FrameExplanation) -> Self {
        let queries::FrameExplanation { name, reason, gates, place, reproduced, picture } = explanation;
        Self {
            name,
            reason: reason.into(),
            gates: gates.into_iter().map(Gate::from).collect(),
            place: place.map(PlaceExplanation::from),
            reproduced,
            picture,
        }
    }
}

impl From<GateView> for Gate {
    fn from(view: GateView) -> Self {
        let GateView { name, gate, description } = view;
        let mapper::Gate { passed, value, required } = gate;
        Self { name: name.to_owned(), passed, value, required, description }
    }
}

impl From<explanation::Explanation> for PlaceExplanation {
    fn from(explanation: explanation::Explanation) -> Self {
        let explanation::Explanation {
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
        Self {
            place,
            prior,
            posterior,
            new_place_posterior,
            log_likelihood,
            new_place_log_likelihood,
            average_place_log_likelihood,
            words_for: words_for.into_iter().map(WordEvidence::from).collect(),
            words_against: words_against.into_iter().map(WordEvidence::from).collect(),
            other_words_nats,
        }
    }
}

impl From<explanation::WordEvidence> for WordEvidence {
    fn from(evidence: explanation::WordEvidence) -> Self {
        let explanation::WordEvidence { word, seen, hits, looks, nats } = evidence;
        Self { word, seen, hits, looks, nats }
    }
}
