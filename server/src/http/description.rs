//! What the REST API says of itself: an OpenAPI document, and a page that shows it.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Router;
use axum::body::Bytes;
use axum::http::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, RefOr, ResponseBuilder};
use utoipa::{IntoResponses, Modify, OpenApi as _};
use utoipa_axum::router::OpenApiRouter;
use utoipa_swagger_ui::SwaggerFile;

use super::parameters::InPath;
use super::{ErrorBody, HttpError, nothing_here};
use crate::error::ServiceError;
use crate::service::Service;

/// Where the document lies.
const DOCUMENT: &str = "/v1/openapi.json";

/// Swagger UI runs from the files that are served here; it draws its icons from `data:`.
const PAGE_POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "Waypost REST",
        description = "What Waypost's maps hold, for people, scripts and other languages; maps, models and tokens are \
            made and removed here, too. It answers what gRPC (`waypost.v1`) answers, field by field. Frames go one by \
            one here; a robot streams them over gRPC.\n\n\
            - **Names** are paths, as in gRPC: `maps/demo/sessions/monday/frames/7`.\n\
            - **Fields** are always there; one that has no value is `null`. New ones may come: ignore what you \
            do not know.\n\
            - **Enumerations** are lower-case text, as in `loop_closure`.\n\
            - **Numbers** of 64 bits are JSON numbers. Stamps and times in nanoseconds (`…_ns`) exceed 2^53: read \
            them as 64-bit integers; JavaScript's `JSON.parse` rounds them to about a quarter of a microsecond, \
            unless it is given a reviver that makes a BigInt of the source text.\n\
            - **Lists** come in pages of at most 1000: ask again with the `next_page_token` of the page before \
            until it is empty.\n\
            - **Errors** are `application/problem+json` (RFC 9457) with `\"error\": {\"code\": …, \"message\": …}` \
            beside, and say how to mend it.\n\
            - **Pages of other sites** may change nothing in a browser, unless they send a token as a bearer's."
    ),
    servers((url = "/", description = "The server that this was read from.")),
    components(schemas(ErrorBody)),
    tags(
        (name = "maps", description = "Maps, their places, and the loops they closed."),
        (name = "sessions", description = "Runs of robots: what they saw, and what they were told."),
        (name = "navigations", description = "Robots that are led along a map: where they are, and where they are to go."),
        (name = "models", description = "What is learnt before a robot drives."),
        (name = "corrections", description = "What people say of loop closures, against what the map decided."),
        (name = "merges", description = "Maps that become one: looked for, proposed with their evidence, decided."),
        (name = "tokens", description = "Who may use the server. Where it has no token, it serves everyone on the \
            same machine."),
        (name = "server", description = "What the server has to say of itself."),
        (name = "jobs", description = "Work that takes longer than a call."),
        (name = "exports", description = "Whole tables, sent as they are read. Rows that a robot adds meanwhile may \
            be in or not."),
    ),
    security((), ("token" = [])),
    modifiers(&Shared)
)]
struct Description;

/// The description before any route.
pub(super) fn begin() -> OpenApiRouter<Arc<Service>> {
    OpenApiRouter::with_openapi(Description::openapi())
}

/// The document and the page, in the same words for everyone.
pub(super) fn routes(description: &OpenApi) -> anyhow::Result<Router<Arc<Service>>> {
    let document = Bytes::from(format!("{}\n", description.to_pretty_json()?));
    let document = move || std::future::ready(([(CONTENT_TYPE, "application/json")], document.clone()));
    Ok(Router::new()
        .route(DOCUMENT, get(document))
        .route("/docs", get(async || Redirect::permanent("/docs/")))
        .route("/docs/", get(async || page("index.html".to_owned()).await))
        .route("/docs/{*file}", get(async |InPath(file): InPath<String>| page(file).await)))
}

/// A file of Swagger UI.
async fn page(file: String) -> Result<Response, HttpError> {
    let config = utoipa_swagger_ui::Config::from(DOCUMENT)
        .use_base_layout()
        .validator_url("none")
        .try_it_out_enabled(true)
        .default_models_expand_depth(0);
    let file = utoipa_swagger_ui::serve(&file, Arc::new(config)).map_err(ServiceError::internal)?;
    let SwaggerFile { bytes, content_type, .. } = file.ok_or_else(nothing_here)?;
    let mut response = bytes.into_response();
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::try_from(content_type).map_err(ServiceError::internal)?);
    headers.insert(CONTENT_SECURITY_POLICY, PAGE_POLICY);
    Ok(response)
}

/// An error that any route may answer with: status, name in the description, when it comes.
struct Refusal(StatusCode, &'static str, &'static str);

const INVALID: Refusal =
    Refusal(StatusCode::BAD_REQUEST, "Invalid", "The request is wrong and will stay so.");
const UNAUTHENTICATED: Refusal = Refusal(
    StatusCode::UNAUTHORIZED,
    "Unauthenticated",
    "This server needs a token, and none that it knows came.",
);
const FORBIDDEN: Refusal = Refusal(StatusCode::FORBIDDEN, "Forbidden", "The token does not allow this.");
const NOT_FOUND: Refusal = Refusal(StatusCode::NOT_FOUND, "NotFound", "What the path names does not exist.");
const CONFLICT: Refusal =
    Refusal(StatusCode::CONFLICT, "Conflict", "The request is right, but not as things are.");
const OVERLOADED: Refusal = Refusal(
    StatusCode::TOO_MANY_REQUESTS,
    "Overloaded",
    "More is asked for than the server can do; try again later.",
);
const INTERNAL: Refusal =
    Refusal(StatusCode::INTERNAL_SERVER_ERROR, "Internal", "The server is at fault; its log says more.");
const UNAVAILABLE: Refusal =
    Refusal(StatusCode::SERVICE_UNAVAILABLE, "Unavailable", "The same request may succeed a little later.");

const TOO_LARGE: Refusal = Refusal(StatusCode::PAYLOAD_TOO_LARGE, "TooLarge", "The body is too large.");
const UNSUPPORTED: Refusal =
    Refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, "Unsupported", "The body is neither JPEG, PNG nor JSON.");

const LATE: Refusal =
    Refusal(StatusCode::GATEWAY_TIMEOUT, "Late", "It took too long; ask for less at a time.");

const REFUSALS: [Refusal; 9] =
    [INVALID, UNAUTHENTICATED, FORBIDDEN, NOT_FOUND, CONFLICT, OVERLOADED, INTERNAL, UNAVAILABLE, LATE];

/// The errors of a read.
pub(super) struct Refusals;

impl IntoResponses for Refusals {
    fn responses() -> BTreeMap<String, RefOr<utoipa::openapi::Response>> {
        references(&REFUSALS)
    }
}

/// What a route can come to besides that takes a body.
pub(super) struct BodyRefusals;

impl IntoResponses for BodyRefusals {
    fn responses() -> BTreeMap<String, RefOr<utoipa::openapi::Response>> {
        references(&[TOO_LARGE])
    }
}

/// What a query can come to besides.
pub(super) struct QueryRefusals;

impl IntoResponses for QueryRefusals {
    fn responses() -> BTreeMap<String, RefOr<utoipa::openapi::Response>> {
        references(&[TOO_LARGE, UNSUPPORTED])
    }
}

fn references(refusals: &[Refusal]) -> BTreeMap<String, RefOr<utoipa::openapi::Response>> {
    let reference = |Refusal(status, name, _): &Refusal| {
        (status.as_u16().to_string(), Ref::from_response_name(*name).into())
    };
    refusals.iter().map(reference).collect()
}

/// What the routes refer to.
struct Shared;

impl Modify for Shared {
    fn modify(&self, description: &mut OpenApi) {
        let components = description.components.get_or_insert_default();
        for Refusal(_, name, when) in REFUSALS.into_iter().chain([TOO_LARGE, UNSUPPORTED]) {
            let body = ContentBuilder::new().schema(Some(Ref::from_schema_name("ErrorBody"))).build();
            let response =
                ResponseBuilder::new().description(when).content("application/problem+json", body).build();
            components.responses.insert(name.to_owned(), response.into());
        }
        let token = HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some("Needed where the server has tokens: `authorization: Bearer {secret}`."))
            .build();
        components.add_security_scheme("token", SecurityScheme::Http(token));
    }
}
