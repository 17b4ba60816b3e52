//! Maps that become one: looked for, seen and decided.

use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::ToSchema;
use waypost_proto::v1;

use super::HttpError;
use super::bodies::{InBody, JsonBody};
use super::description::{BodyRefusals, Refusals};
use super::frames::{ImageFile, unless_known};
use super::parameters::{InPath, InQuery, MergePath, Nothing, Paging};
use crate::pages::Page;
use crate::service::Service;
use crate::service::merges::{CommitPolicy, MergeRequest};
use crate::service::tokens::Caller;
use crate::wire::merges::merge as message;

/// All merges, newest first.
#[utoipa::path(get, path = "/v1/merges", tag = "merges", params(Paging),
    responses((status = 200, description = "A page of merges.", body = v1::ListMergesResponse), Refusals))]
pub(super) async fn list_merges(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListMergesResponse>, HttpError> {
    let Page { items, next } = service.merges.list(&caller, page_size, &page_token).await?;
    let merges = items.into_iter().map(message).collect();
    Ok(Json(v1::ListMergesResponse { merges, next_page_token: next }))
}

/// Begins to look for maps on each other; the job that does so is named in the answer. For administrators.
#[utoipa::path(post, path = "/v1/merges", tag = "merges",
    request_body(content = MergeMaps, description = "The maps, and what is to be done once an overlap is found."),
    responses((status = 200, description = "The merge.", body = v1::Merge), Refusals, BodyRefusals))]
pub(super) async fn merge_maps(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(MergeMaps { sources, target, auto_commit, min_support }): InBody<MergeMaps>,
) -> Result<Json<v1::Merge>, HttpError> {
    let commit_policy = if auto_commit { CommitPolicy::Automatic } else { CommitPolicy::OnRequest };
    let request = MergeRequest { sources, target, commit_policy, min_support };
    Ok(Json(message(service.merges.begin(&caller, request).await?)))
}

/// A merge as it stands.
#[utoipa::path(get, path = "/v1/merges/{merge}", tag = "merges", params(MergePath),
    responses((status = 200, description = "The merge.", body = v1::Merge), Refusals))]
pub(super) async fn get_merge(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(MergePath { merge }): InPath<MergePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Merge>, HttpError> {
    Ok(Json(message(service.merges.get(&caller, &format!("merges/{merge}")).await?)))
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
    Extension(caller): Extension<Arc<Caller>>,
    InPath(MergePath { merge }): InPath<MergePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let picture = service.merges.picture(&caller, &format!("merges/{merge}")).await?;
    unless_known(&headers, "image/svg+xml", picture.into_bytes()).await
}

/// Commits or discards what was proposed, or undoes what was committed. For administrators.
#[utoipa::path(put, path = "/v1/merges/{merge}/decision", tag = "merges", params(MergePath),
    request_body(content = Decision, description = "What is to become of it."),
    responses((status = 200, description = "The merge.", body = v1::Merge), Refusals, BodyRefusals))]
pub(super) async fn decide_merge(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(MergePath { merge }): InPath<MergePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(Decision { decision }): InBody<Decision>,
) -> Result<Json<v1::Merge>, HttpError> {
    let name = format!("merges/{merge}");
    let view = match decision {
        Decided::Commit => service.merges.commit(&caller, &name).await?,
        Decided::Discard => service.merges.discard(&caller, &name).await?,
        Decided::Undo => service.merges.undo(&caller, &name).await?,
    };
    Ok(Json(message(view)))
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
    /// Commits as soon as an overlap of every source was found, without waiting for a decision.
    #[serde(default)]
    auto_commit: bool,
    /// How many matches must agree with each other; 5 if left out.
    #[serde(default)]
    #[schema(minimum = 3)]
    min_support: Option<u32>,
}

impl JsonBody for MergeMaps {
    const TAKES: &str = r#"{"sources": ["maps/A", "maps/B"], "target": "maps/C"}"#;
}

/// What is to become of a merge.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"decision": "commit"}))]
pub(super) struct Decision {
    decision: Decided,
}

impl JsonBody for Decision {
    const TAKES: &str = r#"{"decision": "commit"}, "discard" or "undo""#;
}

#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Decided {
    Commit,
    Discard,
    Undo,
}
