//! Calls of one token that are open at a time. What an answer takes is given back once it is read, so that who reads none
//! is not given another.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::error::ServiceError;

/// How long a call goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallKind {
    /// Until it is answered: the answer, or the next part of it, waits in memory to be read.
    Answered,
    /// For as long as its caller likes; it reads what it asked for, or sends.
    Lasting,
}

/// Answers of one token that are made, or wait to be read, at a time. Others wait their turn.
const ANSWERS: usize = 32;

/// Streams of one token: more than connections could be of robots.
const STREAMS: usize = 1024;

/// How long a call waits for its turn, and then its caller.
const PATIENCE: Duration = Duration::from_secs(10);
const RETRY: Duration = Duration::from_secs(2);

/// The calls that one token has open. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Calls {
    answered: Arc<Semaphore>,
    lasting: Arc<Semaphore>,
    patience: Duration,
}

/// A call that is open, until this is dropped.
#[derive(Debug)]
pub(crate) struct OpenCall {
    _permit: OwnedSemaphorePermit,
}

impl Calls {
    pub(crate) fn none() -> Self {
        let of = |calls| Arc::new(Semaphore::new(calls));
        Self { answered: of(ANSWERS), lasting: of(STREAMS), patience: PATIENCE }
    }

    /// Waits for its turn.
    ///
    /// # Errors
    /// UNAVAILABLE if that does not come for a while.
    pub(crate) async fn open(&self, kind: CallKind) -> Result<OpenCall, ServiceError> {
        let calls = match kind {
            CallKind::Answered => &self.answered,
            CallKind::Lasting => &self.lasting,
        };
        match tokio::time::timeout(self.patience, calls.clone().acquire_owned()).await {
            Ok(permit) => Ok(OpenCall { _permit: permit.map_err(ServiceError::internal)? }),
            Err(_elapsed) => {
                Err(ServiceError::Unavailable { message: too_many(kind), retry_after: Some(RETRY) })
            }
        }
    }
}

fn too_many(kind: CallKind) -> String {
    match kind {
        CallKind::Answered => format!(
            "{ANSWERS} calls with this token are being answered, or have answers that nobody reads; read or cancel those, \
             or call again in {} s",
            RETRY.as_secs()
        ),
        CallKind::Lasting => format!(
            "{STREAMS} streams are open with this token; close those that are not needed, or call again in {} s",
            RETRY.as_secs()
        ),
    }
}

/// The body of an answer; the call is over when it is read or given up.
pub(crate) struct UntilRead<B> {
    body: B,
    /// `None` where calls are not counted.
    _call: Option<OpenCall>,
}

impl<B> UntilRead<B> {
    pub(crate) fn new(body: B, call: Option<OpenCall>) -> Self {
        Self { body, _call: call }
    }
}

impl<B: HttpBody + Unpin> HttpBody for UntilRead<B> {
    type Data = B::Data;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<B::Data>, B::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn who_reads_no_answers_gets_no_more_and_others_do() {
        let calls = Calls { patience: Duration::from_millis(20), ..Calls::none() };
        let mut open = Vec::new();
        for _ in 0..ANSWERS {
            open.push(UntilRead::new(
                tonic::body::Body::empty(),
                Some(calls.open(CallKind::Answered).await.unwrap()),
            ));
        }
        let refused = calls.open(CallKind::Answered).await.unwrap_err();
        assert!(matches!(refused, ServiceError::Unavailable { retry_after: Some(_), .. }), "{refused:?}");
        assert!(calls.open(CallKind::Lasting).await.is_ok());
        assert!(Calls::none().open(CallKind::Answered).await.is_ok());
        // Once one is read there is a turn for who waits.
        let patient = Calls { patience: Duration::from_secs(30), ..calls.clone() };
        let waiting = tokio::spawn(async move { patient.open(CallKind::Answered).await });
        tokio::task::yield_now().await;
        open.pop();
        assert!(waiting.await.unwrap().is_ok());
    }
}
