//! A map with its model as one file, out and in.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing};
use super::uploads::{BinaryFile, Upload};
use crate::names::map_name;
use crate::service::Service;
use crate::service::tokens::Caller;
use crate::wire::jobs::job;

/// A snapshot of a map as it is now, with its model; robots go on meanwhile. For administrators.
#[utoipa::path(get, path = "/v1/maps/{map}/export", tag = "maps", params(MapPath),
    responses((status = 200, description = "The file, sent as it is written. One that breaks off is refused by an import.",
        body = BinaryFile, content_type = "application/octet-stream"), Refusals))]
pub(super) async fn export_map(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    let pieces = service.snapshots.export(&map_name(&map)).await?;
    let name = format!("attachment; filename=\"{map}.waypost-map\"");
    let about = [(CONTENT_TYPE, "application/octet-stream".to_owned()), (CONTENT_DISPOSITION, name)];
    Ok((about, Body::from_stream(pieces)).into_response())
}

/// Takes in a snapshot as a new map of this name. It is checked as a whole and stored by a job. For administrators.
#[utoipa::path(post, path = "/v1/maps/{map}/import", tag = "maps", params(MapPath),
    request_body(content = BinaryFile, content_type = "application/octet-stream", description = "The file, of at most 16 GiB."),
    responses((status = 200, description = "The job that does so.", body = v1::Job), Refusals))]
pub(super) async fn import_map(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    body: Body,
) -> Result<Json<v1::Job>, HttpError> {
    let mut file = Upload::of(&service, body);
    let mut upload = service.snapshots.begin_import(&caller, &map).await?;
    while let Some(piece) = file.next().await? {
        service.snapshots.add_bytes(&mut upload, piece).await?;
    }
    Ok(Json(job(service.snapshots.start_import(upload).await?)))
}
