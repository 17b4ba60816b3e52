//! Every request has an id, a line in the log, its place in the metrics, and an end.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tracing::Instrument;

use super::access::standing;
use super::{HttpError, Said};
use crate::error::ServiceError;
use crate::net::connections::Came;
use crate::net::request_id::RequestId;
use crate::service::Service;
use crate::service::refusals::Refusal;
use crate::service::tokens::Caller;

/// Within which an answer begins.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Who sends a file may take longer; an upload itself says how long it may pause.
const UPLOADS: [&str; 2] = ["/v1/maps/{map}/import", "/v1/models"];

/// What machines ask every few seconds is logged for those alone who look for it.
const POLLED: [&str; 3] = ["/healthz", "/readyz", "/metrics"];

/// Watches over a request; goes around everything else.
pub(super) async fn watch(State(service): State<Arc<Service>>, mut request: Request, next: Next) -> Response {
    let asker =
        standing(&request).and_then(|standing| service.neighbours.standing(request.headers(), &standing));
    if let Some(asker) = asker {
        request.extensions_mut().insert(ConnectInfo(Came(Some(asker))));
    }
    let id = RequestId::of(request.headers());
    let since = Instant::now();
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let route = request.extensions().get::<MatchedPath>().map(|route| route.as_str().to_owned());
    let peer = standing(&request).map(|standing| standing.peer());
    let span = id.span();
    async move {
        let uploads =
            method == Method::POST && route.as_deref().is_some_and(|route| UPLOADS.contains(&route));
        let answering = next.run(request);
        let mut response = if uploads { answering.await } else { within(TIMEOUT, answering).await };
        id.tell(response.headers_mut());
        let status = response.status().as_u16();
        let took = since.elapsed();
        let route = route.as_deref().unwrap_or("unknown");
        service.metrics().http_request(method.as_str(), route, status, took);
        if status >= 400 {
            service.refusals.note(refusal(format!("{method} {path}"), peer, &response));
        }
        let peer = peer.map(|peer| peer.to_string());
        // Whole microseconds: more digits are noise.
        let duration_ms = took.as_micros() as f64 / 1e3;
        if POLLED.contains(&path.as_str()) {
            tracing::debug!(%method, path, status, duration_ms, peer, "answered");
        } else {
            tracing::info!(%method, path, status, duration_ms, peer, "answered");
        }
        response
    }
    .instrument(span)
    .await
}

fn refusal(request: String, peer: Option<IpAddr>, response: &Response) -> Refusal {
    let (code, message) = match response.extensions().get::<Said>() {
        Some(Said { code, message }) => (*code, message.clone()),
        // Refused by what reads requests, before any handler.
        None => ("unknown", response.status().to_string()),
    };
    let token = response.extensions().get::<Arc<Caller>>().and_then(|caller| caller.token.clone());
    Refusal { request, code, message, peer, token, stream: String::new() }
}

async fn within(patience: Duration, answering: impl Future<Output = Response>) -> Response {
    tokio::time::timeout(patience, answering).await.unwrap_or_else(|_elapsed| {
        let message =
            format!("this took more than {} s; ask for less at a time, or later", patience.as_secs());
        HttpError(ServiceError::deadline(message)).into_response()
    })
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;

    use super::*;

    #[tokio::test]
    async fn an_answer_that_does_not_come_is_given_up() {
        let answered = within(TIMEOUT, async { "ok".into_response() }).await;
        assert_eq!(answered.status(), StatusCode::OK);
        let (began, patience) = (Instant::now(), Duration::from_millis(50));
        let given_up = within(patience, std::future::pending()).await;
        assert_eq!(given_up.status(), StatusCode::GATEWAY_TIMEOUT);
        assert!(began.elapsed() >= patience);
    }
}
