//! Who may use the server, and who asks.

use std::borrow::Cow;
use std::sync::Arc;

use axum::extract::State;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};
use waypost_proto::v1;

use super::HttpError;
use super::bodies::{InBody, JsonBody};
use super::description::{BodyRefusals, Refusals};
use super::parameters::{InPath, InQuery, Nothing, Paging, TokenPath};
use crate::pages::Page;
use crate::quotas;
use crate::role;
use crate::service::Service;
use crate::service::tokens::{Caller, LimitChange, NewToken, Rotation, TokenRow};
use crate::wire::tokens::{caller, requested_limits, token as message};

/// All tokens, by name, without their secrets. For administrators.
#[utoipa::path(get, path = "/v1/tokens", tag = "tokens", params(Paging),
    responses((status = 200, description = "A page of tokens.", body = v1::ListTokensResponse), Refusals))]
pub(super) async fn list_tokens(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListTokensResponse>, HttpError> {
    let Page { items, next } = service.tokens.list(page_size, &page_token)?;
    let tokens = items.into_iter().map(|row| shown(&service, row)).collect();
    Ok(Json(v1::ListTokensResponse { tokens, next_page_token: next }))
}

/// Makes a token. Its secret is only in the answer: the server keeps a hash. For administrators; from the first token on, the
/// server asks everyone for one.
#[utoipa::path(post, path = "/v1/tokens", tag = "tokens",
    request_body(content = CreateToken, description = "What it is called, and what its holder may do."),
    responses((status = 200, description = "The token and its secret.", body = v1::CreateTokenResponse), Refusals, BodyRefusals))]
pub(super) async fn create_token(
    State(service): State<Arc<Service>>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(new): InBody<CreateToken>,
) -> Result<Json<v1::CreateTokenResponse>, HttpError> {
    let (created, secret) = service.tokens.create(new.into()).await?;
    Ok(Json(v1::CreateTokenResponse { token: Some(shown(&service, created)), secret }))
}

/// Gives a token a new secret, which is only in the answer; the one before stays good for a while. For administrators.
#[utoipa::path(post, path = "/v1/tokens/{token}/rotate", tag = "tokens", params(TokenPath),
    request_body(content = RotateToken, description = "How long the secret before stays good, and how long the token lives."),
    responses((status = 200, description = "The token and its new secret.", body = v1::RotateTokenResponse), Refusals, BodyRefusals))]
pub(super) async fn rotate_token(
    State(service): State<Arc<Service>>,
    InPath(TokenPath { token }): InPath<TokenPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(RotateToken { overlap_s, lifetime_s }): InBody<RotateToken>,
) -> Result<Json<v1::RotateTokenResponse>, HttpError> {
    let rotation = Rotation { overlap_s, lifetime_s };
    let (rotated, secret) = service.tokens.rotate(&format!("tokens/{token}"), rotation).await?;
    Ok(Json(v1::RotateTokenResponse { token: Some(shown(&service, rotated)), secret }))
}

/// Changes the quotas of a token, which keeps its secret. It holds for streams that are open, too. For administrators.
#[utoipa::path(patch, path = "/v1/tokens/{token}", tag = "tokens", params(TokenPath),
    request_body(content = UpdateToken, description = "Quotas as they are to be; those that are left out stay."),
    responses((status = 200, description = "The token.", body = v1::Token), Refusals, BodyRefusals))]
pub(super) async fn update_token(
    State(service): State<Arc<Service>>,
    InPath(TokenPath { token }): InPath<TokenPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(UpdateToken { quotas, lifted }): InBody<UpdateToken>,
) -> Result<Json<v1::Token>, HttpError> {
    let limits = requested_limits(quotas.unwrap_or_default().0);
    let lifted = lifted.into_iter().map(Quota::named).collect();
    let limited = service.tokens.limit(&format!("tokens/{token}"), LimitChange { limits, lifted }).await?;
    Ok(Json(shown(&service, limited)))
}

/// A token with what there is that counts for it.
fn shown(service: &Service, row: TokenRow) -> v1::Token {
    let used = service.tokens.used_by(&row.name);
    message(row, used)
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
#[schema(example = json!({"token_id": "robot-7", "role": "robot", "maps": ["hall", "floor2-*"], "quotas": {"max_sessions": 3}}))]
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
    /// How much its holder may have and send; what is left out is not limited.
    #[serde(default)]
    quotas: Option<Quotas>,
}

impl JsonBody for CreateToken {
    const TAKES: &str = r#"{"token_id": "robot-7", "role": "robot"}, "reader" or "admin""#;
}

impl From<CreateToken> for NewToken {
    fn from(request: CreateToken) -> Self {
        let CreateToken { token_id, role, abilities, maps, lifetime_s, quotas } = request;
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
        let limits = requested_limits(quotas.unwrap_or_default().0);
        Self { name: token_id, role, abilities, maps, lifetime_s, limits }
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

impl JsonBody for RotateToken {
    const TAKES: &str = r#"{}, or {"overlap_s": 3600}"#;
}

/// A change of a token's quotas.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"quotas": {"max_sessions": 5}, "lifted": ["kept"]}))]
pub(super) struct UpdateToken {
    /// Quotas as they are to be; those that are left out stay as they are.
    #[serde(default)]
    quotas: Option<Quotas>,
    /// Quotas that are lifted.
    #[serde(default)]
    lifted: Vec<Quota>,
}

impl JsonBody for UpdateToken {
    const TAKES: &str = r#"{"quotas": {"max_sessions": 3}}, or {"lifted": ["sessions"]}"#;
}

/// How much the holder of a token may have and send.
#[derive(Debug, Default, Deserialize)]
struct Quotas(v1::Quotas);

impl PartialSchema for Quotas {
    /// The contract's, of which nothing needs to be there.
    fn schema() -> RefOr<Schema> {
        match v1::Quotas::schema() {
            RefOr::T(Schema::Object(mut quotas)) => {
                quotas.required.clear();
                quotas.into()
            }
            other => other,
        }
    }
}

impl ToSchema for Quotas {
    fn name() -> Cow<'static, str> {
        "QuotasRequest".into()
    }
}

/// One of the quotas of a token.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Quota {
    Maps,
    Sessions,
    FramesPerSecond,
    Kept,
}

impl Quota {
    fn named(self) -> quotas::Quota {
        match self {
            Quota::Maps => quotas::Quota::Maps,
            Quota::Sessions => quotas::Quota::Sessions,
            Quota::FramesPerSecond => quotas::Quota::FramesPerSecond,
            Quota::Kept => quotas::Quota::Kept,
        }
    }
}
