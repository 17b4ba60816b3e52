//! Files that come in, in pieces.

use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes};
use futures::StreamExt;
use tokio_util::sync::CancellationToken;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::frames::ImageFile;
use crate::error::ServiceError;
use crate::service::Service;

/// Largest piece that is handed on.
const PIECE_BYTES: usize = 1 << 20;

/// How long an upload may pause, as over gRPC.
const PAUSE: Duration = Duration::from_secs(120);

/// The bytes of a file, for the description alone.
pub(super) enum BinaryFile {}

impl PartialSchema for BinaryFile {
    fn schema() -> RefOr<Schema> {
        ImageFile::schema()
    }
}

impl ToSchema for BinaryFile {}

/// A body as it comes in. Its type is no matter: what is in it says what it is.
pub(super) struct Upload {
    body: BodyDataStream,
    waiting: Vec<u8>,
    patience: Duration,
    stopping: CancellationToken,
}

impl Upload {
    pub(super) fn of(service: &Service, body: Body) -> Self {
        let stopping = service.stopping().clone();
        Self { body: body.into_data_stream(), waiting: Vec::new(), patience: PAUSE, stopping }
    }

    /// The next piece; `None` after the last.
    pub(super) async fn next(&mut self) -> Result<Option<Vec<u8>>, ServiceError> {
        while self.waiting.len() < PIECE_BYTES
            && let Some(part) = self.part().await?
        {
            self.waiting.extend_from_slice(&part);
        }
        let rest = self.waiting.split_off(self.waiting.len().min(PIECE_BYTES));
        let piece = std::mem::replace(&mut self.waiting, rest);
        Ok((!piece.is_empty()).then_some(piece))
    }

    async fn part(&mut self) -> Result<Option<Bytes>, ServiceError> {
        tokio::select! {
            part = self.body.next() => part.transpose().map_err(|error| {
                ServiceError::invalid(format_args!("the file broke off: {error}; send all of it, again"))
            }),
            () = tokio::time::sleep(self.patience) => Err(ServiceError::deadline(format_args!(
                "nothing of the file came within {} s; send it again, without such a pause",
                self.patience.as_secs()
            ))),
            () = self.stopping.cancelled() => Err(ServiceError::stopping()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use futures::stream;

    use super::*;

    fn upload(body: Body) -> Upload {
        let (patience, stopping) = (Duration::from_millis(50), CancellationToken::new());
        Upload { body: body.into_data_stream(), waiting: Vec::new(), patience, stopping }
    }

    #[tokio::test]
    async fn pieces_are_as_large_as_they_may_be_and_no_larger() {
        let parts = [PIECE_BYTES - 1, 3, 2 * PIECE_BYTES + 5, 0, 1];
        let parts = parts.map(|length| Ok::<_, std::io::Error>(Bytes::from(vec![7; length])));
        let mut upload = upload(Body::from_stream(stream::iter(parts)));
        let mut lengths = Vec::new();
        while let Some(piece) = upload.next().await.unwrap() {
            lengths.push(piece.len());
        }
        assert_eq!(lengths, [PIECE_BYTES, PIECE_BYTES, PIECE_BYTES, 8]);
        assert_eq!(upload.next().await, Ok(None));
    }

    #[tokio::test]
    async fn one_that_pauses_or_breaks_off_is_refused() {
        let began = Instant::now();
        let silent = stream::pending::<Result<Bytes, std::io::Error>>();
        let paused = upload(Body::from_stream(silent)).next().await.unwrap_err();
        assert!(paused.to_string().contains("without such a pause"), "{paused}");
        assert!(began.elapsed() >= Duration::from_millis(50));
        let broken = stream::iter([Err::<Bytes, _>(std::io::Error::other("cut"))]);
        let broken = upload(Body::from_stream(broken)).next().await.unwrap_err();
        assert!(broken.to_string().contains("send all of it"), "{broken}");
        let mut stopped = upload(Body::from_stream(stream::pending::<Result<Bytes, std::io::Error>>()));
        stopped.patience = PAUSE;
        stopped.stopping.cancel();
        assert_eq!(stopped.next().await, Err(ServiceError::stopping()));
    }
}
