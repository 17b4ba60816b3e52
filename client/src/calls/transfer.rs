//! Files in chunks, up and down. An upload whose source fails does not look complete to the server.

use std::io;

use futures::stream::BoxStream;
use futures::{Stream, StreamExt};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::oneshot;
use tonic::{Response, Status, Streaming};

use crate::client::Client;
use crate::error::Error;

const CHUNK_BYTES: usize = 1 << 20;

/// Runs `call` with the items of `source` as its requests.
///
/// To a server a stream of requests that ends early looks complete, and one that is cancelled may.
/// Only a stream that fails does not. The one way to make it fail is a request that cannot be
/// encoded, so `unsendable` makes one above the client's size limit; it never leaves this process.
pub(super) async fn upload<T, F, R>(
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
            // The receiver outlives the call; only the first error is reported.
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

/// A file in chunks of 1 MiB, the last one shorter.
pub(super) fn chunks(
    file: impl AsyncRead + Send + Unpin + 'static,
) -> impl Stream<Item = io::Result<Vec<u8>>> + Send {
    futures::stream::try_unfold(file, |mut file| async move {
        let mut chunk = Vec::new();
        (&mut file).take(CHUNK_BYTES as u64).read_to_end(&mut chunk).await?;
        Ok((!chunk.is_empty()).then_some((chunk, file)))
    })
}

/// Writes the chunks of a download to `file`; returns its length in bytes.
pub(super) async fn download<M>(
    client: &Client,
    response: Result<Response<Streaming<M>>, Status>,
    chunk_of: impl Fn(M) -> Vec<u8>,
    file: &mut (impl AsyncWrite + Unpin),
) -> Result<u64, Error> {
    let mut messages = client.taken(response)?;
    let mut length_bytes = 0;
    while let Some(message) = client.met(messages.message().await)? {
        let chunk = chunk_of(message);
        file.write_all(&chunk).await.map_err(Error::Write)?;
        length_bytes += chunk.len() as u64;
    }
    file.flush().await.map_err(Error::Write)?;
    Ok(length_bytes)
}

#[cfg(test)]
mod tests {
    use futures::TryStreamExt;

    use super::*;

    #[tokio::test]
    async fn a_file_is_cut_into_chunks_that_join_to_itself() {
        let file: Vec<u8> = (0..CHUNK_BYTES * 2 + 5).map(|byte| (byte % 251) as u8).collect();
        let cut: Vec<Vec<u8>> = chunks(std::io::Cursor::new(file.clone())).try_collect().await.unwrap();
        assert_eq!(cut.iter().map(Vec::len).collect::<Vec<_>>(), [CHUNK_BYTES, CHUNK_BYTES, 5]);
        assert_eq!(cut.concat(), file);
    }
}
