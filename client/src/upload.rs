//! Uploads that can fail while they are read, without looking complete to the server.

use std::io;

use futures::stream::BoxStream;
use futures::{Stream, StreamExt};
use tokio::sync::oneshot;
use tonic::{Response, Status};

use crate::error::Error;

/// Runs `call` with the items of `source` as its requests.
///
/// A stream of requests that just ends looks complete, and so may one that is cancelled: servers see
/// either as the end. What they cannot mistake is a stream that fails. A stream of requests has no
/// other way to fail than an item that cannot be encoded, so `unsendable` makes one that is longer than
/// the client's limit; it never leaves this process.
pub(crate) async fn upload<T, F, R>(
    source: impl Stream<Item = io::Result<T>> + Send + 'static,
    unsendable: fn() -> T,
    endpoint: &str,
    call: impl FnOnce(BoxStream<'static, T>) -> F,
) -> Result<R, Error>
where
    T: Send + 'static,
    F: Future<Output = Result<Response<R>, Status>>,
{
    let (failed, mut failure) = oneshot::channel();
    let mut failed = Some(failed);
    let requests = source.map(move |item| {
        item.unwrap_or_else(|error| {
            // The receiver outlives the call; only the first error is told.
            let _ = failed.take().map(|failed| failed.send(error));
            unsendable()
        })
    });
    let response = call(requests.boxed()).await;
    match failure.try_recv() {
        Ok(error) => Err(Error::Read(error)),
        Err(_all_was_read) => {
            response.map(Response::into_inner).map_err(|status| Error::from_status(&status, endpoint))
        }
    }
}
