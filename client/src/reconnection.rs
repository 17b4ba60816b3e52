//! Streams that outlive their connections: connect, talk, wait, and again.

use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::sleep;

pub use backoff::Reconnection;
pub(crate) use backoff::{Backoff, random_seed};
pub(crate) use link::{Link, LinkEnd};

use crate::error::Error;

mod backoff;
mod link;

/// This side of a stream that is opened again whenever its connection breaks.
pub(crate) trait Exchange: Send + 'static {
    /// One connection.
    type Link: Send;

    /// Opens the stream over a new connection.
    fn connect(&mut self) -> impl Future<Output = Result<Self::Link, LinkEnd>> + Send;

    /// Sends and receives until all is done or the link ends.
    fn converse(&mut self, link: Self::Link) -> impl Future<Output = Result<(), LinkEnd>> + Send;

    /// The link broke.
    fn on_broken(&mut self, reason: &str);

    /// Whether another connection would have nothing to do.
    fn is_finished(&self) -> bool;

    /// Frames without an outcome.
    fn unacknowledged(&self) -> usize;

    fn backoff(&mut self) -> &mut Backoff;
}

/// The task that keeps an exchange going. It goes on when this is dropped; see
/// [`abort`](Self::abort).
#[derive(Debug)]
pub(crate) struct Task {
    /// None once its end has been reported.
    running: Option<JoinHandle<Result<(), Error>>>,
}

impl Task {
    pub(crate) fn spawn(exchange: impl Exchange) -> Self {
        Self { running: Some(tokio::spawn(run(exchange))) }
    }

    /// Waits for the server's first response.
    ///
    /// # Errors
    /// The reason why the stream was not opened.
    pub(crate) async fn opened<T>(&mut self, opened: oneshot::Receiver<T>) -> Result<T, Error> {
        match opened.await {
            Ok(opened) => Ok(opened),
            Err(_never_opened) => {
                self.ending().await?;
                Err(Error::Protocol("the stream ended before it was opened"))
            }
        }
    }

    /// Waits for the end of the stream.
    ///
    /// # Errors
    /// The reason why it ended, reported once.
    pub(crate) async fn ending(&mut self) -> Result<(), Error> {
        let Some(running) = self.running.as_mut() else { return Ok(()) };
        let ended = running.await;
        self.running = None;
        match ended {
            Ok(ending) => ending,
            Err(failure) => match failure.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                Err(_cancelled) => Err(Error::Protocol("the runtime was shut down under the stream")),
            },
        }
    }

    pub(crate) fn abort(&self) {
        if let Some(running) = &self.running {
            running.abort();
        }
    }
}

async fn run(mut exchange: impl Exchange) -> Result<(), Error> {
    loop {
        let end = match exchange.connect().await {
            Ok(link) => exchange.converse(link).await,
            Err(end) => Err(end),
        };
        match end {
            Ok(()) => return Ok(()),
            Err(LinkEnd::Final(error)) => return Err(error),
            Err(LinkEnd::Broken(_)) if exchange.is_finished() => return Ok(()),
            Err(LinkEnd::Broken(reason)) => {
                exchange.on_broken(&reason);
                let unacknowledged = exchange.unacknowledged();
                sleep(exchange.backoff().delay_or_give_up(unacknowledged, &reason)?).await;
            }
        }
    }
}
