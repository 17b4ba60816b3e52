//! Who may use the server, and who asks.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::HeaderMap;
use serde::Deserialize;
use utoipa::ToSchema;
use waypost_proto::v1;

use super::HttpError;
use super::access::secret;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, Nothing, Paging, TokenPath};
use crate::error::ServiceError;
use crate::pages::Page;
use crate::role;
use crate::service::Service;
use crate::wire::tokens::{caller, token as message};

/// All tokens, by name, without their secrets. For administrators.
#[utoipa::path(get, path = "/v1/tokens", tag = "tokens", params(Paging),
    responses((status = 200, description = "A page of tokens.", body = v1::ListTokensResponse), Refusals))]
pub(super) async fn list_tokens(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListTokensResponse>, HttpError> {
    let Page { items, next } = service.tokens.list(page_size, &page_token)?;
    let tokens = items.into_iter().map(message).collect();
    Ok(Json(v1::ListTokensResponse { tokens, next_page_token: next }))
}

/// Makes a token. Its secret is only in the answer: the server keeps a hash. For administrators; from the first token on, the
/// server asks everyone for one.
#[utoipa::path(post, path = "/v1/tokens", tag = "tokens",
    request_body(content = CreateToken, description = "What it is called, and what its holder may do."),
    responses((status = 200, description = "The token and its secret.", body = v1::CreateTokenResponse), Refusals))]
pub(super) async fn create_token(
    State(service): State<Arc<Service>>,
    InQuery(Nothing {}): InQuery<Nothing>,
    request: Result<Json<CreateToken>, JsonRejection>,
) -> Result<Json<v1::CreateTokenResponse>, HttpError> {
    let Json(CreateToken { token_id, role }) = request.map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; send {{\"token_id\": \"robot-7\", \"role\": \"robot\"}}, or \"admin\", as application/json",
            rejection.body_text()
        ))
    })?;
    let role = match role {
        Role::Robot => role::Role::Robot,
        Role::Admin => role::Role::Admin,
    };
    let (created, secret) = service.tokens.create(&token_id, role).await?;
    Ok(Json(v1::CreateTokenResponse { token: Some(message(created)), secret }))
}

/// Deletes a token: it is refused from then on, and what was begun with it ends. For administrators.
#[utoipa::path(delete, path = "/v1/tokens/{token}", tag = "tokens", params(TokenPath),
    responses((status = 200, description = "It is gone.", body = v1::DeleteTokenResponse), Refusals))]
pub(super) async fn delete_token(
    State(service): State<Arc<Service>>,
    InPath(TokenPath { token }): InPath<TokenPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::DeleteTokenResponse>, HttpError> {
    service.tokens.delete(&format!("tokens/{token}")).await?;
    Ok(Json(v1::DeleteTokenResponse {}))
}

/// Who asks, and what the server lets them do.
#[utoipa::path(get, path = "/v1/whoami", tag = "tokens",
    responses((status = 200, description = "Who asks.", body = v1::Caller), Refusals))]
pub(super) async fn get_caller(
    State(service): State<Arc<Service>>,
    InQuery(Nothing {}): InQuery<Nothing>,
    headers: HeaderMap,
) -> Result<Json<v1::Caller>, HttpError> {
    Ok(Json(caller(service.tokens.caller(secret(&headers).as_deref())?)))
}

/// A token that is to be made.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"token_id": "robot-7", "role": "robot"}))]
pub(super) struct CreateToken {
    /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
    token_id: String,
    role: Role,
}

/// What the holder of a token may do. `robot`: stream into maps, query and read. `admin`: everything.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Role {
    Robot,
    Admin,
}
