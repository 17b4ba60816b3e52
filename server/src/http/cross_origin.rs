//! Pages of other origins that may ask: none, unless the setting `cors_origins` names them.

use std::time::Duration;

use http::{HeaderMap, HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowOrigin, CorsLayer};

use crate::net::origin::Origin;

/// For how long a browser need not ask again whether it may ask.
const MAX_AGE: Duration = Duration::from_secs(3600);

/// What a page may send. A token goes by `authorization`; what a browser remembers of a password never does.
const SENT: [HeaderName; 5] = [
    header::AUTHORIZATION,
    header::CONTENT_TYPE,
    header::IF_NONE_MATCH,
    HeaderName::from_static("last-event-id"),
    HeaderName::from_static("x-request-id"),
];

/// What a page may read of an answer, besides what every page may.
const READ: [HeaderName; 6] = [
    header::ALLOW,
    header::CONTENT_DISPOSITION,
    header::ETAG,
    header::RETRY_AFTER,
    header::WWW_AUTHENTICATE,
    HeaderName::from_static("x-request-id"),
];

const METHODS: [Method; 6] =
    [Method::GET, Method::HEAD, Method::POST, Method::PUT, Method::PATCH, Method::DELETE];

/// Tells browsers that pages of `origins` may ask and read the answers, as the Fetch standard has it. `None` where there are no
/// such origins: then nothing is said, which browsers take for no.
pub(super) fn layer(origins: &[Origin]) -> Option<CorsLayer> {
    let listed: Vec<HeaderValue> =
        origins.iter().filter_map(|origin| HeaderValue::from_str(origin.as_str()).ok()).collect();
    let layer = CorsLayer::new()
        .allow_methods(METHODS)
        .allow_headers(SENT)
        .expose_headers(READ)
        // A page on the internet that its user trusts may ask a server on the user's own network.
        .allow_private_network(true)
        .max_age(MAX_AGE);
    (!listed.is_empty()).then(|| layer.allow_origin(AllowOrigin::list(listed)))
}

/// Whether a page of one of `origins` sends this, by itself: without what a browser remembers of a password.
pub(super) fn is_trusted(headers: &HeaderMap, origins: &[Origin]) -> bool {
    let origin = headers.get(header::ORIGIN).and_then(|origin| origin.to_str().ok());
    !headers.contains_key(header::AUTHORIZATION)
        && origin.is_some_and(|origin| origins.iter().any(|listed| listed.as_str() == origin))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_listed_page_is_trusted_and_a_remembered_password_is_not() {
        let origins = ["https://fleet.example".parse().unwrap()];
        let of = |said: &[(&'static str, &str)]| {
            let mut headers = HeaderMap::new();
            for (name, value) in said {
                headers.insert(*name, HeaderValue::from_str(value).unwrap());
            }
            is_trusted(&headers, &origins)
        };
        assert!(of(&[("origin", "https://fleet.example")]));
        for said in [
            &[][..],
            &[("origin", "http://fleet.example")],
            &[("origin", "https://fleet.example.evil")],
            &[("origin", "null")],
            &[("origin", "https://fleet.example"), ("authorization", "Basic eDp5")],
        ] {
            assert!(!of(said), "{said:?}");
        }
        assert!(layer(&[]).is_none());
    }
}
