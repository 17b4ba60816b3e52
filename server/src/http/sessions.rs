use std::sync::Arc;

use axum::extract::State;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::IntoParams;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Paging, Parameters, SessionPath};
use crate::names::{map_name, session_name};
use crate::pages::Page;
use crate::service::Service;
use crate::service::frames::FramesWanted;
use crate::service::tokens::Caller;
use crate::wire::jobs::job;
use crate::wire::sessions::{listed_frame, open_stream, session as message};

/// The sessions of a map that let it grow, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions", tag = "sessions", params(MapPath, Paging),
    responses((status = 200, description = "A page of sessions.", body = v1::ListSessionsResponse), Refusals))]
pub(super) async fn list_sessions(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListSessionsResponse>, HttpError> {
    let Page { items, next } = service.frames.sessions(&map_name(&map), page_size, &page_token).await?;
    let sessions = items.into_iter().map(message).collect();
    Ok(Json(v1::ListSessionsResponse { sessions, next_page_token: next }))
}

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct StreamsAsked {
    /// Only those into this map.
    #[param(example = "hall")]
    map: String,
}

impl Parameters for StreamsAsked {
    const TAKES: &str = "map=MAP";
}

/// Streams of robots that are open now, by when they were opened. Robots that are led are among a map's navigations.
#[utoipa::path(get, path = "/v1/streams", tag = "sessions", params(StreamsAsked),
    responses((status = 200, description = "The streams; at most 500 are open at a time.",
        body = v1::ListOpenStreamsResponse), Refusals))]
pub(super) async fn list_open_streams(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InQuery(StreamsAsked { map }): InQuery<StreamsAsked>,
) -> Result<Json<v1::ListOpenStreamsResponse>, HttpError> {
    let map = if map.is_empty() { map } else { map_name(&map) };
    let streams = service.sessions.open_streams(&caller, &map).await?;
    Ok(Json(v1::ListOpenStreamsResponse { streams: streams.into_iter().map(open_stream).collect() }))
}

/// A session.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}", tag = "sessions", params(SessionPath),
    responses((status = 200, description = "The session.", body = v1::Session), Refusals))]
pub(super) async fn get_session(
    State(service): State<Arc<Service>>,
    InPath(SessionPath { map, session }): InPath<SessionPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Session>, HttpError> {
    Ok(Json(message(service.frames.session(&session_name(&map, &session)).await?)))
}

/// Takes a session out of its map, as a job: the map is then as if the robot had not been there. For administrators.
#[utoipa::path(delete, path = "/v1/maps/{map}/sessions/{session}", tag = "sessions", params(SessionPath),
    responses((status = 200, description = "The job that does so.", body = v1::Job), Refusals))]
pub(super) async fn delete_session(
    State(service): State<Arc<Service>>,
    InPath(SessionPath { map, session }): InPath<SessionPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Job>, HttpError> {
    Ok(Json(job(service.rewriting.delete_session(&session_name(&map, &session)).await?)))
}

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct FramesAsked {
    /// Most entries in one answer; 0 asks for the default.
    #[param(minimum = 0, maximum = 1000, default = 100, example = 100)]
    page_size: u32,
    /// `next_page_token` of the page before. Left out, the first page comes.
    page_token: String,
    /// Only the frames that their robot calls so, as by the name of a file. Left out, all come.
    #[param(example = "000147.jpg")]
    note: String,
    /// Only the frames from this sequence number on.
    #[param(example = 1)]
    from_sequence: u64,
}

impl Parameters for FramesAsked {
    const TAKES: &str = "page_size=NUMBER, page_token=TOKEN, note=TEXT and from_sequence=NUMBER";
}

/// The frames of a session with what was decided about them, by sequence number.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames", tag = "sessions",
    params(SessionPath, FramesAsked),
    responses((status = 200, description = "A page of frames.", body = v1::ListFramesResponse), Refusals))]
pub(super) async fn list_frames(
    State(service): State<Arc<Service>>,
    InPath(SessionPath { map, session }): InPath<SessionPath>,
    InQuery(FramesAsked { page_size, page_token, note, from_sequence }): InQuery<FramesAsked>,
) -> Result<Json<v1::ListFramesResponse>, HttpError> {
    let wanted = FramesWanted { note: &note, from_sequence };
    let Page { items, next } =
        service.frames.list(&session_name(&map, &session), wanted, page_size, &page_token).await?;
    let frames = items.into_iter().map(listed_frame).collect();
    Ok(Json(v1::ListFramesResponse { frames, next_page_token: next }))
}
