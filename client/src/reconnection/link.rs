//! One connection of a stream: opening it, and whether to reconnect after its end.

use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Response, Status, Streaming};

use crate::error::{Error, broken_connection};

/// Opening a large map takes a server seconds.
const OPENING_TIMEOUT: Duration = Duration::from_secs(30);

/// An open stream of requests `Q` and responses `A`.
pub(crate) struct Link<Q, A> {
    pub(crate) requests: mpsc::Sender<Q>,
    pub(crate) responses: Streaming<A>,
}

/// Why a link ended.
pub(crate) enum LinkEnd {
    /// The connection broke, for this reason: reconnect.
    Broken(String),
    /// The server refuses the stream: do not reconnect.
    Final(Error),
}

impl<Q, A> Link<Q, A> {
    /// Opens a stream by its first request, and waits for the first response. Up to `capacity`
    /// requests wait to be sent.
    pub(crate) async fn open<F>(
        capacity: usize,
        first: Q,
        call: impl FnOnce(ReceiverStream<Q>) -> F,
    ) -> Result<(Self, A), LinkEnd>
    where
        F: Future<Output = Result<Response<Streaming<A>>, Status>>,
    {
        let (requests, queue) = mpsc::channel(capacity);
        // The queue is empty: there is room.
        let _ = requests.try_send(first);
        let opening = async {
            let responses = call(ReceiverStream::new(queue)).await.map_err(|status| LinkEnd::of(&status))?;
            let mut link = Self { requests, responses: responses.into_inner() };
            let first = link.next().await?;
            Ok((link, first))
        };
        timeout(OPENING_TIMEOUT, opening).await.unwrap_or_else(|_elapsed| {
            let waited_s = OPENING_TIMEOUT.as_secs();
            Err(LinkEnd::Broken(format!("it did not open the stream within {waited_s} s")))
        })
    }

    /// The next response.
    pub(crate) async fn next(&mut self) -> Result<A, LinkEnd> {
        let response = self.responses.message().await.map_err(|status| LinkEnd::of(&status))?;
        response.ok_or_else(LinkEnd::closed)
    }
}

impl LinkEnd {
    /// The server ended the stream without a status.
    pub(crate) fn closed() -> Self {
        LinkEnd::Broken("it closed the stream".to_owned())
    }

    /// The stream ended with a status.
    pub(crate) fn of(status: &Status) -> Self {
        if let Some(reason) = broken_connection(status) {
            return LinkEnd::Broken(reason);
        }
        match status.code() {
            // UNKNOWN stands for a stream that was cut off without a status, as by a server that
            // dies.
            Code::Unavailable
            | Code::ResourceExhausted
            | Code::DeadlineExceeded
            | Code::Cancelled
            | Code::Unknown => LinkEnd::Broken(status.message().to_owned()),
            Code::Aborted
            | Code::NotFound
            | Code::FailedPrecondition
            | Code::InvalidArgument
            | Code::PermissionDenied
            | Code::Unauthenticated
            | Code::AlreadyExists
            | Code::OutOfRange
            | Code::Unimplemented
            | Code::Internal
            | Code::DataLoss
            | Code::Ok => LinkEnd::Final(Error::refused(status)),
        }
    }
}
