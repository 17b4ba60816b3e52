//! Who may ask over HTTP.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use http::uri::Authority;
use http::{HeaderMap, HeaderValue, header};

use super::HttpError;
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::tokens::Access;

/// What tells whether the server lives is asked by machines that hold no token.
const OPEN: [&str; 2] = ["/healthz", "/readyz"];

/// Serves those who may see it; all that is here reads, so any token will do.
pub(super) async fn guard(State(service): State<Arc<Service>>, request: Request, next: Next) -> Response {
    let access = if OPEN.contains(&request.uri().path()) { Access::Open } else { Access::Robot };
    if access != Access::Open && service.tokens().serve_this_machine() && !addresses_this_machine(&request) {
        return refusal(ServiceError::PermissionDenied {
            message: "this server has no token, so it is for this machine alone and answers to localhost or an IP \
                      address, not to other names: a page in a browser could have made its own name lead here; ask \
                      http://127.0.0.1, or create a token, or say --allow-anonymous"
                .to_owned(),
        });
    }
    let secret = secret(request.headers());
    match service.admit(secret.as_deref(), access) {
        Ok(_) => next.run(request).await,
        Err(error) => refusal(error),
    }
}

/// Whether the request names where it goes in a way that no foreign name server can have a say in.
fn addresses_this_machine(request: &Request) -> bool {
    let host = match request.headers().get(header::HOST) {
        Some(host) => host.to_str().ok().and_then(|host| host.parse::<Authority>().ok()),
        // Every browser names one.
        None if request.uri().authority().is_none() => return true,
        None => request.uri().authority().cloned(),
    };
    let Some(host) = host else { return false };
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

/// The secret in `Authorization: Bearer SECRET`, or the password in Basic: a browser asks for that by
/// itself. Any user name will do.
fn secret(headers: &HeaderMap) -> Option<String> {
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
    use super::*;

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
        for foreign in ["waypost.example", "localhost.example:7601", "127.0.0.1.example", "xlocalhost", "a b"]
        {
            assert!(!of(foreign), "{foreign}");
        }
        assert!(addresses_this_machine(&Request::new(axum::body::Body::empty())));
    }
}
