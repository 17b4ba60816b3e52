//! Who may ask over HTTP.

use std::net::IpAddr;
use std::sync::Arc;

use axum::RequestExt;
use axum::body::Body;
use axum::extract::{ConnectInfo, MatchedPath, RawPathParams, Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use futures::stream::{self, StreamExt};
use http::uri::Authority;
use http::{HeaderMap, HeaderName, HeaderValue, Method, header};
use http_body::Body as _;

use super::HttpError;
use super::cross_origin;
use super::inspector;
use crate::error::ServiceError;
use crate::net::calls::{CallKind, UntilRead};
use crate::net::connections::Came;
use crate::net::messages::{MAX_MESSAGE_BYTES, Room};
use crate::net::origin::Origin;
use crate::net::standing::Standing;
use crate::service::Service;
use crate::service::tokens::{Access, Admitted, Caller, Ending};

/// How the page that asks is related to this server, as newer browsers say.
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// What tells whether the server lives is asked by machines that hold no token.
const OPEN: [&str; 2] = ["/healthz", "/readyz"];

/// What asks for something else than reads do by GET, and changes for administrators do by other methods.
const ROUTES: [(&str, Access); 7] = [
    ("/v1/maps/{map}/query", Access::LOCALIZE),
    ("/v1/maps/{map}/navigations/{navigation}/goal", Access::NAVIGATE),
    ("/v1/maps/{map}/places/{place}/label", Access::NAVIGATE),
    ("/v1/maps/{map}/export", Access::ADMIN),
    ("/v1/whoami", Access::Token),
    // Messages name maps and what is in them, of whichever token.
    ("/v1/refusals", Access::Server),
    // Names machines and addresses.
    ("/v1/cluster", Access::Server),
];

/// What robots send to, and people read.
const FRAME: &str = "/v1/maps/{map}/sessions/{session}/frames/{sequence}";

/// What is about the whole server: tokens, and all that changes models.
const TOKENS: &str = "/v1/tokens";
const MODELS: &str = "/v1/models";

/// What is asked, and by which pages of other origins.
#[derive(Clone)]
pub(super) struct Asked {
    pub(super) service: Arc<Service>,
    pub(super) origins: Arc<[Origin]>,
}

/// Serves those who may ask for it, as over gRPC.
pub(super) async fn guard(State(asked): State<Asked>, mut request: Request, next: Next) -> Response {
    let Asked { service, origins } = asked;
    let route = request.extensions().get::<MatchedPath>().map(|route| route.as_str().to_owned());
    let access = access(request.method(), request.uri().path(), route.as_deref());
    if access != Access::Open && service.tokens.serve_this_machine() && !addresses_this_machine(&request) {
        return refusal(ServiceError::PermissionDenied {
            message: "this server has no token, so it is for this machine alone and answers to localhost or an IP \
                      address, not to other names: a page in a browser could have made its own name lead here; ask \
                      http://127.0.0.1, or create a token, or say --allow-anonymous"
                .to_owned(),
        });
    }
    let foreign =
        comes_from_another_site(request.headers()) && !cross_origin::is_trusted(request.headers(), &origins);
    if !request.method().is_safe() && foreign {
        return refusal(ServiceError::PermissionDenied {
            message: "a page of another site asked for this in a browser, and such a page may change nothing here; \
                      ask from this server's own page, send a token as `authorization: Bearer SECRET`, or name the \
                      page's origin in the setting cors_origins"
                .to_owned(),
        });
    }
    let secret = secret(request.headers());
    let standing = standing(&request);
    let peer = standing.as_ref().map(Standing::peer);
    let map = map_in_path(&mut request).await;
    let admitted = service.tokens.admit(peer, secret.as_deref(), access).and_then(|admitted| {
        match (access, standing) {
            (Access::Token | Access::May(_) | Access::Server, Some(standing)) => {
                standing.admit(admitted.admission())?;
            }
            (Access::Open, _) | (_, None) => {}
        }
        map.map_or(Ok(()), |map| admitted.caller.check_map(&map))?;
        request.extensions_mut().insert(admitted.caller.clone());
        Ok(admitted)
    });
    // It must hear that it made the first token, or deleted its own.
    let of_tokens = route.is_some_and(|route| route.starts_with(TOKENS));
    match admitted {
        Ok(Admitted { caller, ending: _, room }) if of_tokens => {
            by(caller, with_room(&room, access, request, next).await)
        }
        Ok(Admitted { caller, ending, room }) => by(
            caller,
            tokio::select! {
                biased;
                response = with_room(&room, access, request, next) => response.map(|body| until_over(body, ending.clone())),
                () = ending.over().cancelled() => refusal(ending.why()),
            },
        ),
        Err(error) => match service.tokens.holder(secret.as_deref()) {
            Some(caller) => by(caller, refusal(error)),
            None => refusal(error),
        },
    }
}

/// Has whoever watches over the request hear who it was.
fn by(caller: Arc<Caller>, mut response: Response) -> Response {
    response.extensions_mut().insert(caller);
    response
}

/// What is known of the connection that a request came over.
pub(super) fn standing(request: &Request) -> Option<Standing> {
    request.extensions().get::<ConnectInfo<Came>>().and_then(|ConnectInfo(Came(standing))| standing.clone())
}

/// Answers a request while there is room for its body.
async fn with_room(room: &Room, access: Access, request: Request, next: Next) -> Response {
    let body = request.body().size_hint();
    let most =
        body.upper().map_or(MAX_MESSAGE_BYTES, |bytes| usize::try_from(bytes).unwrap_or(MAX_MESSAGE_BYTES));
    let kind = if is_stream(&request) { CallKind::Lasting } else { CallKind::Answered };
    let call = match access {
        Access::Open => None,
        Access::Token | Access::May(_) | Access::Server => match room.calls().open(kind).await {
            Ok(call) => Some(call),
            Err(error) => return refusal(error),
        },
    };
    match room.reserve(most).await {
        Ok(_reserved) => next.run(request).await.map(|body| Body::new(UntilRead::new(body, call))),
        Err(error) => refusal(error),
    }
}

/// Whether what happens is told for as long as somebody listens, or a file is sent.
fn is_stream(request: &Request) -> bool {
    !request.method().is_safe() || request.uri().path().ends_with("/events")
}

fn access(method: &Method, path: &str, route: Option<&str>) -> Access {
    if OPEN.contains(&path) || (method.is_safe() && inspector::holds(path)) {
        return Access::Open;
    }
    // That there is nothing is told to everyone who holds a token.
    let Some(route) = route else { return if method.is_safe() { Access::Token } else { Access::Server } };
    if let Some((_, access)) = ROUTES.into_iter().find(|(known, _)| *known == route) {
        return access;
    }
    if route.starts_with(TOKENS) || (route.starts_with(MODELS) && !method.is_safe()) {
        return Access::Server;
    }
    match (method.is_safe(), route) {
        (true, _) => Access::READ,
        (false, FRAME) => Access::STREAM,
        (false, _) => Access::ADMIN,
    }
}

/// The map that a path names, as its route reads it.
async fn map_in_path(request: &mut Request) -> Option<String> {
    let parts = request.extract_parts::<RawPathParams>().await.ok()?;
    parts.iter().find(|(name, _)| *name == "map").map(|(_, map)| map.to_owned())
}

/// Whether a browser sends this for a page that is not this server's own. It adds by itself what it remembers of a password,
/// but never a bearer's token.
fn comes_from_another_site(headers: &HeaderMap) -> bool {
    let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or("not text"));
    if text(header::AUTHORIZATION).is_some_and(is_bearer) {
        return false;
    }
    match text(SEC_FETCH_SITE) {
        Some(site) => !["same-origin", "none"].contains(&site),
        // Older browsers tell the page's origin alone; what is no browser tells nothing.
        None => text(header::ORIGIN).is_some_and(|origin| {
            let host = origin.split_once("://").map(|(_, host)| host);
            host.is_none() || host != text(header::HOST)
        }),
    }
}

/// `body`, which fails when its token is deleted or expires, so that a part is not taken for the whole.
fn until_over(body: Body, ending: Ending) -> Body {
    // One that is there already is as good as sent, and keeps its length.
    if body.size_hint().exact().is_some() {
        return body;
    }
    let over = Box::pin(ending.over().clone().cancelled_owned());
    let sending = Some((body.into_data_stream(), over, ending));
    Body::from_stream(stream::unfold(sending, |sending| async {
        let (mut body, mut over, ending) = sending?;
        tokio::select! {
            biased;
            () = &mut over => Some((Err(axum::Error::new(ending.why())), None)),
            piece = body.next() => piece.map(|piece| (piece, Some((body, over, ending)))),
        }
    }))
}

/// Whether the request names where it goes in a way that no foreign name server can have a say in.
fn addresses_this_machine(request: &Request) -> bool {
    let host = match request.headers().get(header::HOST) {
        Some(host) => host.to_str().ok().and_then(|host| host.parse::<Authority>().ok()),
        // Every browser names one.
        None if request.uri().authority().is_none() => return true,
        None => request.uri().authority().cloned(),
    };
    // No browser sends a user's name there, and what follows it is not all that was asked for.
    let Some(host) = host.filter(|host| !host.as_str().contains('@')) else { return false };
    let name = host.host().trim_start_matches('[').trim_end_matches(']').trim_end_matches('.');
    name.parse::<IpAddr>().is_ok()
        || name.eq_ignore_ascii_case("localhost")
        || name.to_ascii_lowercase().ends_with(".localhost")
}

fn refusal(error: ServiceError) -> Response {
    let asks = matches!(error, ServiceError::Unauthenticated { .. });
    let mut response = HttpError(error).into_response();
    if asks {
        let headers = response.headers_mut();
        // A header each: browsers ask for a password at Basic, and some read the first alone.
        let basic = HeaderValue::from_static(r#"Basic realm="waypost", charset="UTF-8""#);
        headers.append(header::WWW_AUTHENTICATE, basic);
        headers.append(header::WWW_AUTHENTICATE, HeaderValue::from_static(r#"Bearer realm="waypost""#));
    }
    response
}

fn is_bearer(authorization: &str) -> bool {
    authorization.split_once(' ').is_some_and(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
}

/// The secret in `Authorization: Bearer SECRET`, or the password in Basic: a browser asks for that by
/// itself. Any user name will do.
pub(super) fn secret(headers: &HeaderMap) -> Option<String> {
    let (scheme, credentials) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    let credentials = credentials.trim();
    if scheme.eq_ignore_ascii_case("bearer") {
        return Some(credentials.to_owned());
    }
    if !scheme.eq_ignore_ascii_case("basic") {
        return None;
    }
    let decoded = String::from_utf8(STANDARD.decode(credentials).ok()?).ok()?;
    decoded.split_once(':').map(|(_user, password)| password.to_owned())
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::body::Bytes;
    use axum::middleware::from_fn_with_state;
    use axum::routing::get;
    use tower::Service as _;

    use super::*;
    use crate::metrics::Metrics;
    use crate::role::Role;
    use crate::service::tokens::{NewToken, Tokens};
    use crate::storage::Storage;

    /// A table whose end is never reached.
    async fn endless() -> Body {
        let rows = stream::repeat(Bytes::from_static(b"row\n"));
        Body::from_stream(rows.then(async |row| {
            tokio::task::yield_now().await;
            Ok::<_, axum::Error>(row)
        }))
    }

    #[tokio::test]
    async fn a_table_breaks_off_when_its_token_is_deleted() {
        let directory = tempfile::tempdir().unwrap();
        let storage = Storage::open(directory.path()).await.unwrap();
        let tokens = Tokens::load(&storage).await.unwrap();
        let service = Arc::new(Service::new(storage, tokens, Metrics::new().unwrap()));
        service.tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
        let (_, secret) = service.tokens.create(NewToken::of("reader", Role::Reader)).await.unwrap();
        let guarded = || {
            let routes = Router::new().route("/table", get(endless)).route("/whole", get(async || "whole"));
            let asked = Asked { service: service.clone(), origins: Arc::from([]) };
            routes.layer(from_fn_with_state(asked, guard))
        };
        let ask = async |path: &str| {
            let bearer = format!("Bearer {secret}");
            let request = Request::builder().uri(path).header(header::AUTHORIZATION, bearer);
            guarded().call(request.body(Body::empty()).unwrap()).await.unwrap()
        };
        let whole = axum::body::to_bytes(ask("/whole").await.into_body(), 100).await.unwrap();
        assert_eq!(whole.as_ref(), b"whole");

        let mut rows = ask("/table").await.into_body().into_data_stream();
        assert_eq!(rows.next().await.unwrap().unwrap().as_ref(), b"row\n");
        service.tokens.delete("tokens/reader").await.unwrap();
        let broken_off = rows.next().await.unwrap().unwrap_err();
        assert!(broken_off.to_string().contains("was deleted"), "{broken_off}");
        assert!(rows.next().await.is_none());
        assert_eq!(ask("/table").await.status(), http::StatusCode::UNAUTHORIZED);
        service.stop().await;
    }

    #[test]
    fn a_secret_is_a_bearer_or_a_password() {
        let of = |value: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::AUTHORIZATION, HeaderValue::from_str(value).unwrap());
            secret(&headers)
        };
        let basic = |pair: &str| of(&format!("Basic {}", STANDARD.encode(pair)));
        assert_eq!(of("Bearer waypost_1").as_deref(), Some("waypost_1"));
        assert_eq!(basic("me:waypost_1").as_deref(), Some("waypost_1"));
        assert_eq!(basic(":waypost:1").as_deref(), Some("waypost:1"));
        assert_eq!(basic("waypost_1"), None);
        for other in ["", "Bearer", "Basic !", "Basic", "Digest waypost_1"] {
            assert_eq!(of(other), None, "{other:?}");
        }
        assert_eq!(secret(&HeaderMap::new()), None);
    }

    #[test]
    fn pages_of_other_sites_are_known_by_what_browsers_say() {
        let of = |said: &[(&'static str, &str)]| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_static("127.0.0.1:7601"));
            for (name, value) in said {
                headers.insert(*name, HeaderValue::from_str(value).unwrap());
            }
            comes_from_another_site(&headers)
        };
        let (own, other) = ("http://127.0.0.1:7601", "http://127.0.0.1:8080");
        for said in [
            &[][..],
            &[("origin", own)],
            &[("sec-fetch-site", "same-origin"), ("origin", "https://behind.a.proxy")],
            &[("sec-fetch-site", "none")],
            &[("origin", other), ("authorization", "Bearer waypost_1")],
        ] {
            assert!(!of(said), "{said:?}");
        }
        for said in [
            &[("origin", other)][..],
            &[("origin", "null")],
            &[("origin", "https://evil.example")],
            &[("sec-fetch-site", "cross-site")],
            &[("sec-fetch-site", "same-site"), ("origin", other)],
            &[("origin", other), ("authorization", "Basic eDp5")],
        ] {
            assert!(of(said), "{said:?}");
        }
    }

    #[test]
    fn names_that_others_could_give_to_this_machine_are_told() {
        let of = |host: &str| {
            let request = Request::builder().uri("/v1/maps").header(header::HOST, host);
            addresses_this_machine(&request.body(axum::body::Body::empty()).unwrap())
        };
        for local in
            ["localhost", "LocalHost:7601", "robot.localhost", "127.0.0.1:7601", "[::1]:7601", "10.0.0.7"]
        {
            assert!(of(local), "{local}");
        }
        for foreign in [
            "waypost.example",
            "localhost.example:7601",
            "127.0.0.1.example",
            "xlocalhost",
            "a b",
            "evil@127.0.0.1",
        ] {
            assert!(!of(foreign), "{foreign}");
        }
        assert!(addresses_this_machine(&Request::new(axum::body::Body::empty())));
    }
}
