//! The page that people see first, and what browsers are told about all that is sent.

use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderValue;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, REFERRER_POLICY, STRICT_TRANSPORT_SECURITY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::response::{Html, IntoResponse, Response};
use maud::{DOCTYPE, Markup, html};

use super::HttpError;
use super::parameters::{InQuery, Paging};
use crate::names::model_name;
use crate::pages::Page;
use crate::service::Service;
use crate::service::maps::MapCounts;
use crate::service::maps::MapView;

/// What is sent loads nothing and runs nothing, unless the route says otherwise.
const NOTHING_RUNS: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// The same, with the page's own style.
const STYLE_ALONE: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; style-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

const STYLE: &str = include_str!("style.css");

/// Browsers take every answer for what it says it is, and run nothing in it.
pub(super) async fn harmless(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(NOTHING_RUNS);
    // Maps change, and what a token opened is not for who comes after.
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

/// Browsers that have come over TLS never come without it again.
pub(super) async fn encrypted_alone(mut response: Response) -> Response {
    response.headers_mut().insert(STRICT_TRANSPORT_SECURITY, HeaderValue::from_static("max-age=31536000"));
    response
}

pub(super) async fn root(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Response, HttpError> {
    let maps = service.maps.list(page_size, &page_token).await?;
    Ok(([(CONTENT_SECURITY_POLICY, STYLE_ALONE)], Html(start_page(&maps).into_string())).into_response())
}

pub(super) async fn style() -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/css; charset=utf-8")], STYLE)
}

/// Whatever is put into this page is escaped by `html!`.
fn start_page(Page { items, next }: &Page<MapView>) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { "Waypost" }
                link rel="stylesheet" href="/style.css";
            }
            body {
                h1 { "Waypost" }
                p { "Tells robots where they have been before. What it knows is here to be read:" }
                ul {
                    li { a href="/docs/" { "the API, to read and to try" } " (" a href="/v1/openapi.json" { "OpenAPI" } ")" }
                    li { a href="/v1/models" { "models" } }
                }
                h2 { "Maps" }
                @if items.is_empty() {
                    p { "There is no map yet. " code { "waypost map create NAME --model MODEL" } " makes one." }
                } @else {
                    (table(items))
                }
                @if !next.is_empty() {
                    p { a href={ "/?page_token=" (next) } { "more maps" } }
                }
            }
        }
    }
}

fn table(maps: &[MapView]) -> Markup {
    html! {
        table {
            thead {
                tr {
                    th { "map" } th { "places" } th { "links" } th { "sessions" } th { "frames" }
                    th { "loop closures" } th { "model" } th { "export" }
                }
            }
            tbody { @for map in maps { (row(map)) } }
        }
    }
}

fn row(MapView { map, model, counts, .. }: &MapView) -> Markup {
    let MapCounts { sessions, frames, loop_closures, places, links } = counts;
    let at = format!("/v1/maps/{map}");
    html! {
        tr {
            th scope="row" { a href=(at) { (map) } }
            td { a href={ (at) "/places" } { (places) } }
            td { (links) }
            td { a href={ (at) "/sessions" } { (sessions) } }
            td { (frames) }
            td { a href={ (at) "/loop-closures" } { (loop_closures) } }
            td.text { a href={ "/v1/" (model_name(model)) } { (model.get(..8).unwrap_or(model)) } }
            td.text {
                "loop closures: " a href={ (at) "/loop-closures.csv" } { "CSV" } ", "
                a href={ (at) "/loop-closures.json" } { "JSON" }
                "; posteriors: " a href={ (at) "/posteriors.csv" } { "CSV" } ", "
                a href={ (at) "/posteriors.json" } { "JSON" }
            }
        }
    }
}
