//! An answer of the owner's on its way to who asked.

use std::pin::Pin;
use std::task::{Context, Poll};

use bytes::Bytes;
use http::HeaderMap;
use http_body::{Body, Frame, SizeHint};
use hyper::body::Incoming;
use tonic::Status;

use crate::error::ServiceError;
use crate::metrics::Forwarding;

/// An answer to a call of gRPC. Where the owner breaks off, it ends with UNAVAILABLE, which clients know what to do with.
pub(super) struct CarriedCall {
    body: Incoming,
    broken_off: bool,
    _forwarding: Forwarding,
}

impl CarriedCall {
    /// Counted as under way for as long as it lives.
    pub(super) fn new(body: Incoming, forwarding: Forwarding) -> Self {
        Self { body, broken_off: false, _forwarding: forwarding }
    }
}

impl Body for CarriedCall {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.broken_off {
            return Poll::Ready(None);
        }
        match Pin::new(&mut self.body).poll_frame(context) {
            Poll::Ready(Some(Err(error))) => {
                tracing::debug!(%error, "the owner of the database broke off");
                self.broken_off = true;
                let mut trailers = HeaderMap::new();
                let ended = Status::from(broken_off()).add_header(&mut trailers);
                Poll::Ready(Some(ended.map(|()| Frame::trailers(trailers))))
            }
            Poll::Ready(Some(Ok(frame))) => Poll::Ready(Some(Ok(frame))),
            Poll::Ready(None) => Poll::Ready(None),
            Poll::Pending => Poll::Pending,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.broken_off || self.body.is_end_stream()
    }
}

/// An answer of REST, which breaks off as the owner does.
pub(super) struct CarriedAnswer {
    body: Incoming,
    _forwarding: Forwarding,
}

impl CarriedAnswer {
    /// Counted as under way for as long as it lives.
    pub(super) fn new(body: Incoming, forwarding: Forwarding) -> Self {
        Self { body, _forwarding: forwarding }
    }
}

impl Body for CarriedAnswer {
    type Data = Bytes;
    type Error = hyper::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, hyper::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

fn broken_off() -> ServiceError {
    ServiceError::unavailable(
        "the server that owns the database broke off; connect again in a moment and send what was not acknowledged",
    )
}
