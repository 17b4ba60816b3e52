//! Every call has an id, a line in the log when it is over, and its place in the metrics.

use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use bytes::Bytes;
use futures::FutureExt;
use futures::future::BoxFuture;
use http::{Request, Response};
use http_body::{Body as HttpBody, Frame, SizeHint};
use tonic::body::Body;
use tonic::{Code, Status};
use tower::{Layer, Service as TowerService};
use tracing::{Instrument, Span};

use super::access::known_method;
use crate::metrics::OpenStream;
use crate::net::request_id::RequestId;
use crate::net::standing::Standing;
use crate::service::Service;
use crate::service::refusals::Refusal;
use crate::service::tokens::Caller;

/// The method whose calls count as open streams.
const STREAM: &str = "/waypost.v1.SessionService/Stream";

/// Watches over all calls; goes around everything else.
#[derive(Clone, Debug)]
pub(super) struct RequestLayer {
    pub(super) service: Arc<Service>,
}

impl<S> Layer<S> for RequestLayer {
    type Service = Watched<S>;

    fn layer(&self, inner: S) -> Watched<S> {
        Watched { inner, service: self.service.clone() }
    }
}

/// A service behind a [`RequestLayer`].
#[derive(Clone, Debug)]
pub(super) struct Watched<S> {
    inner: S,
    service: Arc<Service>,
}

impl<S> TowerService<Request<Body>> for Watched<S>
where
    S: TowerService<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = BoxFuture<'static, Result<Response<Body>, S::Error>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let standing = request.extensions().get::<Standing>();
        let asker =
            standing.and_then(|standing| self.service.neighbours.standing(request.headers(), standing));
        if let Some(asker) = asker {
            request.extensions_mut().insert(asker);
        }
        let id = RequestId::of(request.headers());
        let span = id.span();
        let peer = request.extensions().get::<Standing>().map(Standing::peer);
        let mut call = Call::begin(self.service.clone(), request.uri().path(), peer, span.clone());
        // Entered already: what the service does before its first wait belongs to the call, too.
        let answering = span.in_scope(|| self.inner.call(request)).instrument(span.clone());
        async move {
            let mut response = answering.await?;
            id.tell(response.headers_mut());
            call.token = token_of(&response);
            Ok(match Status::from_header_map(response.headers()) {
                // Refused: there is nothing but the status.
                Some(status) => {
                    call.end(status);
                    response
                }
                None => response.map(|body| Body::new(WatchedBody { body, call: Some(call) })),
            })
        }
        .boxed()
    }
}

/// A call that is under way. One that is dropped was cancelled by its client.
struct Call {
    service: Arc<Service>,
    /// As it came, for the log.
    path: String,
    peer: Option<IpAddr>,
    /// A known method, for the metrics.
    method: &'static str,
    /// Name of the token that it came with, once that is known.
    token: Option<String>,
    since: Instant,
    span: Span,
    _stream: Option<OpenStream>,
    ended: Option<Status>,
}

impl Call {
    fn begin(service: Arc<Service>, path: &str, peer: Option<IpAddr>, span: Span) -> Self {
        let method = known_method(path).map_or("unknown", |(method, _)| method);
        let stream = (method == STREAM).then(|| service.metrics().open_stream());
        Self {
            service,
            path: path.to_owned(),
            peer,
            method,
            token: None,
            since: Instant::now(),
            span,
            _stream: stream,
            ended: None,
        }
    }

    fn end(mut self, status: Status) {
        self.ended = Some(status);
    }

    /// Keeps what was refused. Who goes away on its own was refused nothing.
    fn note(&self) {
        let Some(status) = &self.ended else { return };
        if matches!(status.code(), Code::Ok | Code::Cancelled) {
            return;
        }
        self.service.refusals.note(Refusal {
            request: self.path.clone(),
            code: code_name(status.code()),
            message: status.message().to_owned(),
            peer: self.peer,
            token: self.token.clone(),
            stream: String::new(),
        });
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let status = code_name(self.ended.as_ref().map_or(Code::Cancelled, Status::code));
        self.note();
        let took = self.since.elapsed();
        self.service.metrics().grpc_request(self.method, status, took);
        // Whole microseconds: more digits are noise.
        let duration_ms = took.as_micros() as f64 / 1e3;
        let path = &self.path;
        let peer = self.peer.map(|peer| peer.to_string());
        let _in_call = self.span.enter();
        if path.starts_with("/grpc.health.v1.") {
            tracing::debug!(method = "gRPC", path, status, duration_ms, peer, "answered");
        } else {
            tracing::info!(method = "gRPC", path, status, duration_ms, peer, "answered");
        }
    }
}

/// An answer whose end is the end of its call.
struct WatchedBody {
    body: Body,
    call: Option<Call>,
}

impl WatchedBody {
    fn end(&mut self, status: Status) {
        if let Some(call) = self.call.take() {
            call.end(status);
        }
    }
}

impl HttpBody for WatchedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let span = self.call.as_ref().map_or_else(Span::none, |call| call.span.clone());
        let polled = span.in_scope(|| Pin::new(&mut self.body).poll_frame(context));
        match &polled {
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(trailers) = frame.trailers_ref() {
                    self.end(Status::from_header_map(trailers).unwrap_or_else(without_status));
                }
            }
            Poll::Ready(Some(Err(status))) => self.end(status.clone()),
            // A call without trailers breaks the protocol; tonic makes none.
            Poll::Ready(None) => self.end(without_status()),
            Poll::Pending => {}
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

fn without_status() -> Status {
    Status::unknown("the call ended without a status")
}

/// The token that a call was let in with.
fn token_of<T>(response: &Response<T>) -> Option<String> {
    response.extensions().get::<Arc<Caller>>().and_then(|caller| caller.token.clone())
}

fn code_name(code: Code) -> &'static str {
    match code {
        Code::Ok => "ok",
        Code::Cancelled => "cancelled",
        Code::Unknown => "unknown",
        Code::InvalidArgument => "invalid_argument",
        Code::DeadlineExceeded => "deadline_exceeded",
        Code::NotFound => "not_found",
        Code::AlreadyExists => "already_exists",
        Code::PermissionDenied => "permission_denied",
        Code::ResourceExhausted => "resource_exhausted",
        Code::FailedPrecondition => "failed_precondition",
        Code::Aborted => "aborted",
        Code::OutOfRange => "out_of_range",
        Code::Unimplemented => "unimplemented",
        Code::Internal => "internal",
        Code::Unavailable => "unavailable",
        Code::DataLoss => "data_loss",
        Code::Unauthenticated => "unauthenticated",
    }
}
