//! What people say of loop closures.

use std::sync::Arc;

use axum::extract::State;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::ToSchema;
use waypost_proto::v1;

use super::HttpError;
use super::bodies::{InBody, JsonBody};
use super::description::{BodyRefusals, Refusals};
use super::parameters::{CorrectionPath, InPath, InQuery, MapPath, Nothing, Paging};
use crate::error::ServiceError;
use crate::names::{map_in, map_name, map_of};
use crate::pages::Page;
use crate::service::Service;
use crate::service::tokens::Caller;
use crate::wire::corrections::correction as message;

/// What people said of a map's loop closures, oldest first, undone or not.
#[utoipa::path(get, path = "/v1/maps/{map}/corrections", tag = "corrections", params(MapPath, Paging),
    responses((status = 200, description = "A page of corrections.", body = v1::ListCorrectionsResponse), Refusals))]
pub(super) async fn list_corrections(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListCorrectionsResponse>, HttpError> {
    let Page { items, next } = service.correcting.list(&map_name(&map), page_size, &page_token).await?;
    let corrections = items.into_iter().map(message).collect();
    Ok(Json(v1::ListCorrectionsResponse { corrections, next_page_token: next }))
}

/// Withdraws a loop closure, or says that two frames were at the same place. For administrators.
#[utoipa::path(post, path = "/v1/maps/{map}/corrections", tag = "corrections", params(MapPath),
    request_body(content = Correct, description = "What was decided wrong."),
    responses((status = 200, description = "The correction.", body = v1::Correction), Refusals, BodyRefusals))]
pub(super) async fn correct_map(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(correct): InBody<Correct>,
) -> Result<Json<v1::Correction>, HttpError> {
    map_in(&map_name(&map))?;
    let of_map = |frame: &str| match map_of(frame) {
        Some(other) if other != map => Err(ServiceError::invalid(format_args!(
            "{frame} is not of the map {map}; ask at the map that it is of"
        ))),
        Some(_) | None => Ok(()),
    };
    let view = match &correct {
        Correct::Withdraw { frame } => {
            of_map(frame)?;
            service.correcting.withdraw(&caller, frame).await?
        }
        Correct::Confirm { frame, matched_frame } => {
            of_map(frame)?;
            of_map(matched_frame)?;
            service.correcting.confirm(&caller, frame, matched_frame).await?
        }
    };
    Ok(Json(message(view)))
}

/// Undoes a correction: the map is as if it had not been made. For administrators.
#[utoipa::path(post, path = "/v1/maps/{map}/corrections/{correction}/undo", tag = "corrections", params(CorrectionPath),
    responses((status = 200, description = "The correction.", body = v1::Correction), Refusals))]
pub(super) async fn undo_correction(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(CorrectionPath { map, correction }): InPath<CorrectionPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Correction>, HttpError> {
    let name = format!("maps/{map}/corrections/{correction}");
    Ok(Json(message(service.correcting.undo(&caller, &name).await?)))
}

/// What was decided wrong.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[schema(example = json!({"withdraw": {"frame": "maps/office/sessions/monday/frames/212"}}))]
pub(super) enum Correct {
    /// A frame was not at the place that it closed a loop with.
    Withdraw {
        /// `maps/{map}/sessions/{session}/frames/{sequence}`: the frame that closed the loop.
        frame: String,
    },
    /// Two frames of different places were at the same place.
    Confirm {
        /// `maps/{map}/sessions/{session}/frames/{sequence}`: the frame that came in last.
        frame: String,
        /// The earlier frame, of any session of the same map; in the same form.
        matched_frame: String,
    },
}

impl JsonBody for Correct {
    const TAKES: &str = r#"{"withdraw": {"frame": "maps/MAP/sessions/S/frames/N"}}, or {"confirm": {"frame": …, "matched_frame": …}}"#;
}
