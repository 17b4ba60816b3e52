//! The task that keeps a session going: connect, send, receive, and again.

use std::sync::Arc;
use std::time::Duration;

use futures::future::OptionFuture;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::time::{Instant, sleep_until, timeout};
use waypost_proto::v1;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use super::options::SessionOptions;
use super::window::{Settled, Window};
use crate::client::Transport;
use crate::error::Error;
use crate::frame::{FrameInput, FrameOutcome};
use crate::reconnection::{self, Backoff, Exchange, LinkEnd};

/// Time for the server to end the stream after the last answer.
const CLOSING_TIMEOUT: Duration = Duration::from_secs(2);

/// This side of a session.
pub(super) struct SessionExchange {
    service: SessionServiceClient<Transport>,
    options: SessionOptions,
    /// None once the application knows that the session is open.
    opened: Option<oneshot::Sender<v1::SessionOpened>>,
    slots: Slots,
    frames: mpsc::UnboundedReceiver<FrameInput>,
    outcomes: mpsc::UnboundedSender<FrameOutcome>,
    window: Window,
    backoff: Backoff,
}

type Link = reconnection::Link<v1::StreamRequest, v1::StreamResponse>;

/// Closed with the exchange, so that sending fails afterwards.
struct Slots(Arc<Semaphore>);

impl Drop for Slots {
    fn drop(&mut self) {
        self.0.close();
    }
}

impl SessionExchange {
    /// Also returns the receiver of the server's first response.
    pub(super) fn new(
        service: SessionServiceClient<Transport>,
        options: SessionOptions,
        slots: Arc<Semaphore>,
        frames: mpsc::UnboundedReceiver<FrameInput>,
        outcomes: mpsc::UnboundedSender<FrameOutcome>,
    ) -> (Self, oneshot::Receiver<v1::SessionOpened>) {
        let (opened, on_opened) = oneshot::channel();
        let exchange = Self {
            service,
            backoff: Backoff::new(options.reconnection.clone()),
            options,
            opened: Some(opened),
            slots: Slots(slots),
            frames,
            outcomes,
            window: Window::default(),
        };
        (exchange, on_opened)
    }

    fn opening(&self) -> v1::OpenSession {
        v1::OpenSession {
            map: self.options.map.clone(),
            session_id: self.options.session_id.clone(),
            mode: self.options.mode.into(),
            camera: self.options.camera.clone(),
            words_hash: self.options.words_hash.clone(),
            run_id: self.options.run_id.clone(),
        }
    }

    /// Keeps the session's name for reopening it, and checks that the server has all that it
    /// acknowledged.
    fn on_opened(&mut self, opened: v1::SessionOpened) -> Result<(), LinkEnd> {
        let Some((_, session_id)) = opened.session.rsplit_once('/') else {
            return Err(LinkEnd::Final(Error::Protocol("it named a session without its map")));
        };
        self.options.session_id = session_id.to_owned();
        // A localizing session stores nothing, so a restarted server has lost nothing of it.
        let kept = self.options.mode == v1::SessionMode::Map;
        if let Some(acknowledged) = self.window.last_acknowledged().filter(|_| kept)
            && opened.last_committed_sequence < Some(acknowledged)
        {
            let last_committed = opened.last_committed_sequence;
            return Err(LinkEnd::Final(Error::SessionRewound { acknowledged, last_committed }));
        }
        if self.window.len() == 0 {
            self.backoff.progress();
        }
        match self.opened.take() {
            // If the application no longer waits, it has dropped the session.
            Some(on_opened) => drop(on_opened.send(opened)),
            None => tracing::warn!("back at the server; sending {} frames again", self.window.len()),
        }
        Ok(())
    }

    /// Message and delay if the server asks to send a frame again.
    fn on_response(
        &mut self,
        v1::StreamResponse { content }: v1::StreamResponse,
    ) -> Result<Option<(String, Duration)>, LinkEnd> {
        let outcome = match content {
            Some(Response::Answer(answer)) => FrameOutcome::Answer(answer),
            Some(Response::Refusal(refusal)) => FrameOutcome::Refusal(refusal),
            Some(Response::Opened(_)) => {
                return Err(LinkEnd::Final(Error::Protocol("it opened the session twice")));
            }
            None => return Err(LinkEnd::Final(Error::Protocol("it sent an empty message"))),
        };
        match self.window.settle(outcome).map_err(LinkEnd::Final)? {
            Settled::Done => {
                self.backoff.progress();
                Ok(None)
            }
            Settled::Postponed { message, delay } => Ok(Some((message, delay))),
        }
    }

    fn deliver(&mut self) {
        while let Some(outcome) = self.window.take_outcome() {
            // The receiver is dropped only together with this exchange.
            let _ = self.outcomes.send(outcome);
            self.slots.0.add_permits(1);
        }
    }

    fn no_more_frames(&self) -> bool {
        self.frames.is_closed() && self.frames.is_empty()
    }
}

impl Exchange for SessionExchange {
    type Link = Link;

    async fn connect(&mut self) -> Result<Link, LinkEnd> {
        // Room for the opening and a full window: no request ever waits.
        let capacity = self.options.window_frames.get().saturating_add(1);
        let opening = v1::StreamRequest { content: Some(Request::Open(self.opening())) };
        let (link, first) = Link::open(capacity, opening, |requests| self.service.stream(requests)).await?;
        match first.content {
            Some(Response::Opened(opened)) => self.on_opened(opened).map(|()| link),
            None => Err(LinkEnd::closed()),
            Some(Response::Answer(_) | Response::Refusal(_)) => {
                Err(LinkEnd::Final(Error::Protocol("it answered before the session was opened")))
            }
        }
    }

    /// Sends what is to be sent and takes what comes, until all is done or the link ends.
    async fn converse(&mut self, mut link: Link) -> Result<(), LinkEnd> {
        let mut release_at = None;
        loop {
            while let Some(frame) = self.window.next_to_send() {
                put(&link.requests, Request::Frame(frame))?;
            }
            self.deliver();
            if self.is_finished() {
                close(link).await;
                return Ok(());
            }
            let release = release_at.filter(|_| self.window.only_postponed_left());
            tokio::select! {
                response = link.next() => {
                    if let Some((reason, hint)) = self.on_response(response?)? {
                        let at = match release_at {
                            Some(at) => at,
                            None => {
                                let unacknowledged = self.unacknowledged();
                                let delay = self.backoff.delay_or_give_up(unacknowledged, &reason);
                                let delay = delay.map_err(LinkEnd::Final)?;
                                // The server reserves a turn at the time that it names.
                                Instant::now() + if hint.is_zero() { delay } else { hint }
                            }
                        };
                        release_at = Some(at.max(Instant::now() + hint));
                    }
                }
                frame = self.frames.recv(), if !self.no_more_frames() => {
                    frame.into_iter().for_each(|frame| self.window.push(frame));
                }
                Some(()) = OptionFuture::from(release.map(sleep_until)) => {
                    self.window.release_postponed();
                    release_at = None;
                }
            }
        }
    }

    /// Warns once; further attempts that fail are for the debug log.
    fn on_broken(&mut self, reason: &str) {
        self.window.send_again();
        if self.backoff.is_in_trouble() {
            tracing::debug!("no server yet ({reason})");
        } else {
            let unacknowledged = self.window.len();
            tracing::warn!(
                "lost the server ({reason}); trying again {}, {unacknowledged} frames unacknowledged",
                self.options.reconnection.patience(),
            );
        }
    }

    fn is_finished(&self) -> bool {
        self.window.len() == 0 && self.no_more_frames()
    }

    fn unacknowledged(&self) -> usize {
        self.window.len() + self.frames.len()
    }

    fn backoff(&mut self) -> &mut Backoff {
        &mut self.backoff
    }
}

fn put(requests: &mpsc::Sender<v1::StreamRequest>, content: Request) -> Result<(), LinkEnd> {
    let request = v1::StreamRequest { content: Some(content) };
    match requests.try_send(request) {
        // Closed: the call is over, and its responses say why.
        Ok(()) | Err(mpsc::error::TrySendError::Closed(_)) => Ok(()),
        Err(mpsc::error::TrySendError::Full(_)) => {
            Err(LinkEnd::Final(Error::Protocol("more frames are on their way than the window holds")))
        }
    }
}

/// Ends the stream from this side and lets the server end it from its own.
async fn close(Link { requests, mut responses }: Link) {
    drop(requests);
    let _ = timeout(CLOSING_TIMEOUT, async { while let Ok(Some(_)) = responses.message().await {} }).await;
}
