use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::HttpError;
use super::description::Refusals;
use super::frames::FrameRecord;
use super::geometry::Camera;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, SessionPath};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::frames::SessionView;
use crate::service::models::Page;
use crate::service::names::{map_name, session_name};
use crate::storage::SessionSummary;

/// The sessions of a map that let it grow, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions", tag = "sessions", params(MapPath, Paging),
    responses((status = 200, description = "A page of sessions.", body = SessionList), Refusals))]
pub(super) async fn list_sessions(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<SessionList>, HttpError> {
    let Page { items, next } = service.list_sessions(&map_name(&map), page_size, &page_token).await?;
    let sessions = items.into_iter().map(Session::new).collect::<Result<_, _>>()?;
    Ok(Json(SessionList { sessions, next_page_token: next }))
}

/// A session.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}", tag = "sessions", params(SessionPath),
    responses((status = 200, description = "The session.", body = Session), Refusals))]
pub(super) async fn get_session(
    State(service): State<Arc<Service>>,
    InPath(SessionPath { map, session }): InPath<SessionPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Session>, HttpError> {
    Ok(Json(Session::new(service.session(&session_name(&map, &session)).await?)?))
}

/// The frames of a session with what was decided about them, by sequence number.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames", tag = "sessions",
    params(SessionPath, Paging),
    responses((status = 200, description = "A page of frames.", body = FrameList), Refusals))]
pub(super) async fn list_frames(
    State(service): State<Arc<Service>>,
    InPath(SessionPath { map, session }): InPath<SessionPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<FrameList>, HttpError> {
    let Page { items, next } =
        service.list_frames(&session_name(&map, &session), page_size, &page_token).await?;
    Ok(Json(FrameList {
        frames: items.into_iter().map(FrameRecord::listed).collect(),
        next_page_token: next,
    }))
}

/// A page of sessions.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct SessionList {
    sessions: Vec<Session>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// One run of one robot.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Session {
    /// `maps/{map}/sessions/{session}`
    #[schema(example = "maps/demo/sessions/monday")]
    name: String,
    /// When it was opened, in nanoseconds since 1970.
    create_time_ns: i64,
    #[schema(required)]
    camera: Option<Camera>,
    frames: u64,
    loop_closures: u64,
    /// Null before the first frame; so for the fields that follow.
    #[schema(required)]
    first_sequence: Option<u64>,
    #[schema(required)]
    last_sequence: Option<u64>,
    /// By the robot's clock.
    #[schema(required)]
    first_stamp_ns: Option<i64>,
    #[schema(required)]
    last_stamp_ns: Option<i64>,
}

/// A page of frames.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FrameList {
    frames: Vec<FrameRecord>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

impl Session {
    fn new(view: SessionView) -> Result<Self, ServiceError> {
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
        Ok(Self {
            name,
            create_time_ns: opened_ns,
            camera: camera.map(|encoded| Camera::decode(&encoded)).transpose()?,
            frames,
            loop_closures,
            first_sequence,
            last_sequence,
            first_stamp_ns,
            last_stamp_ns,
        })
    }
}
