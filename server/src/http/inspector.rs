//! The inspector: the page that people see first. It is built from `inspector/` and holds no data, so it is sent to
//! everybody; what it shows it asks of REST, with the token that the person gives it.

use axum::Router;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::frames::{entity_tag, is_known};

/// Its own script and style run, its own REST is asked, pictures come from there: nothing else.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// A file as `inspector/build.mjs` wrote it.
#[derive(Clone, Copy)]
struct File {
    path: &'static str,
    content_type: &'static str,
    content: &'static [u8],
}

/// All that the page is made of.
const FILES: [File; 5] = [
    File {
        path: "/",
        content_type: "text/html; charset=utf-8",
        content: include_bytes!("../../inspector/index.html"),
    },
    File {
        path: "/inspector/inspector.js",
        content_type: "text/javascript; charset=utf-8",
        content: include_bytes!("../../inspector/inspector.js"),
    },
    File {
        path: "/inspector/inspector.css",
        content_type: "text/css; charset=utf-8",
        content: include_bytes!("../../inspector/inspector.css"),
    },
    File {
        path: "/inspector/icon.svg",
        content_type: "image/svg+xml",
        content: include_bytes!("../../inspector/icon.svg"),
    },
    File {
        path: "/inspector/licences.txt",
        content_type: "text/plain; charset=utf-8",
        content: include_bytes!("../../inspector/licences.txt"),
    },
];

/// Whether a path is the page's own.
pub(super) fn holds(path: &str) -> bool {
    FILES.iter().any(|file| file.path == path)
}

pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    FILES.iter().fold(Router::new(), |routes, file| {
        let tag = entity_tag(file.content);
        let send = move |headers: HeaderMap| std::future::ready(sent(file, &tag, &headers));
        routes.route(file.path, get(send))
    })
}

/// The file, unless the browser has it already: a server that was updated has another under the same path.
fn sent(file: &File, tag: &str, headers: &HeaderMap) -> Response {
    let about = [(CACHE_CONTROL, HeaderValue::from_static("no-cache")), (CONTENT_SECURITY_POLICY, POLICY)];
    let tag = [(ETAG, tag.to_owned())];
    if is_known(headers, &tag[0].1) {
        return (StatusCode::NOT_MODIFIED, about, tag).into_response();
    }
    (about, tag, [(CONTENT_TYPE, file.content_type)], file.content).into_response()
}
