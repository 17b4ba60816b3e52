//! Who may use the server, and who asks.

use std::sync::Arc;

use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::ToSchema;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, Nothing, Paging, TokenPath};
use crate::error::ServiceError;
use crate::pages::Page;
use crate::role;
use crate::service::Service;
use crate::service::tokens::{Caller, NewToken, Rotation};
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
    let Json(new) = request.map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; send {{\"token_id\": \"robot-7\", \"role\": \"robot\"}}, \"reader\" or \"admin\", as application/json",
            rejection.body_text()
        ))
    })?;
    let (created, secret) = service.tokens.create(new.into()).await?;
    Ok(Json(v1::CreateTokenResponse { token: Some(message(created)), secret }))
}

/// Gives a token a new secret, which is only in the answer; the one before stays good for a while. For administrators.
#[utoipa::path(post, path = "/v1/tokens/{token}/rotate", tag = "tokens", params(TokenPath),
    request_body(content = RotateToken, description = "How long the secret before stays good, and how long the token lives."),
    responses((status = 200, description = "The token and its new secret.", body = v1::RotateTokenResponse), Refusals))]
pub(super) async fn rotate_token(
    State(service): State<Arc<Service>>,
    InPath(TokenPath { token }): InPath<TokenPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    request: Result<Json<RotateToken>, JsonRejection>,
) -> Result<Json<v1::RotateTokenResponse>, HttpError> {
    let Json(RotateToken { overlap_s, lifetime_s }) = request.map_err(|rejection| {
        ServiceError::invalid(format_args!(
            "{}; send {{}}, or {{\"overlap_s\": 3600}}, as application/json",
            rejection.body_text()
        ))
    })?;
    let rotation = Rotation { overlap_s, lifetime_s };
    let (rotated, secret) = service.tokens.rotate(&format!("tokens/{token}"), rotation).await?;
    Ok(Json(v1::RotateTokenResponse { token: Some(message(rotated)), secret }))
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
    Extension(asks): Extension<Arc<Caller>>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Caller>, HttpError> {
    Ok(Json(caller(&asks)))
}

/// A token that is to be made.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"token_id": "robot-7", "role": "robot", "maps": ["hall", "floor2-*"]}))]
pub(super) struct CreateToken {
    /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
    token_id: String,
    role: Role,
    /// What it may do, where that is less than its role may; all that if left out. Only a robot's can be limited so.
    #[serde(default)]
    abilities: Vec<Ability>,
    /// The maps that it reaches: names, or the beginning of names and an asterisk, as in `floor2-*`. All maps if left out.
    #[serde(default)]
    #[schema(max_items = 64)]
    maps: Vec<String>,
    /// After how many seconds it expires; never if left out.
    #[serde(default)]
    #[schema(minimum = 1)]
    lifetime_s: Option<u32>,
}

impl From<CreateToken> for NewToken {
    fn from(request: CreateToken) -> Self {
        let CreateToken { token_id, role, abilities, maps, lifetime_s } = request;
        let role = match role {
            Role::Reader => role::Role::Reader,
            Role::Robot => role::Role::Robot,
            Role::Admin => role::Role::Admin,
        };
        let ability = |ability| match ability {
            Ability::Read => role::Ability::Read,
            Ability::Localize => role::Ability::Localize,
            Ability::Stream => role::Ability::Stream,
            Ability::Navigate => role::Ability::Navigate,
            Ability::Admin => role::Ability::Admin,
        };
        let abilities = abilities.into_iter().map(ability).collect();
        Self { name: token_id, role, abilities, maps, lifetime_s }
    }
}

/// What the holder of a token may do. `reader`: read, and change nothing. `robot`: stream into maps, query and read.
/// `admin`: everything.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Role {
    Reader,
    Robot,
    Admin,
}

/// One of the things that a token may be good for: to read; to ask where an image or a robot is; to let maps grow; to be
/// led, send robots somewhere and label places; to look after maps, models and tokens.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Ability {
    Read,
    Localize,
    Stream,
    Navigate,
    Admin,
}

/// A token's change to a new secret.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"overlap_s": 3600}))]
pub(super) struct RotateToken {
    /// For how many seconds the secret before stays good; an hour if left out. 0 ends it at once.
    #[serde(default)]
    #[schema(maximum = 604_800)]
    overlap_s: Option<u32>,
    /// After how many seconds from now the token expires. If left out, it expires when it would have.
    #[serde(default)]
    #[schema(minimum = 1)]
    lifetime_s: Option<u32>,
}
