use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use fabmap::PlaceId;
use serde::Deserialize;
use utoipa::IntoParams;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{FramePath, InPath, InQuery, Parameters};
use crate::service::Service;
use crate::wire::recognition::explanation;

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Asked {
    /// Number of the place to explain; left out, the one that was, or could have been, matched.
    place_number: Option<u32>,
    /// How many words for the place to list, and how many against it.
    #[param(minimum = 0, maximum = 100, default = 10)]
    max_words: Option<u32>,
}

impl Parameters for Asked {
    const TAKES: &str = "place_number=NUMBER and max_words=NUMBER";
}

/// Why a frame was decided as it was.
///
/// The map is replayed up to it, so a late frame of a long map takes a while.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}/explanation", tag = "sessions",
    params(FramePath, Asked),
    responses((status = 200, description = "The explanation.", body = v1::FrameExplanation), Refusals))]
pub(super) async fn explain_frame(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(Asked { place_number, max_words }): InQuery<Asked>,
) -> Result<Json<v1::FrameExplanation>, HttpError> {
    let explained = service.queries.explain(&path.name(), place_number.map(PlaceId::new), max_words).await?;
    Ok(Json(explanation(explained)))
}
