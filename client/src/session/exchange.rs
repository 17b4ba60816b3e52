//! The task that keeps a session going: connect, send, receive, and again.

use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::time::Duration;

use futures::future::OptionFuture;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use super::backoff::Backoff;
use super::window::{Settled, Window};
use super::{FrameInput, FrameOutcome, SessionOptions};
use crate::client::Transport;
use crate::error::Error;
use crate::link_end::{self, LinkEnd};

/// All is answered by then; this is courtesy.
const CLOSING_TIMEOUT: Duration = Duration::from_secs(2);

pub(super) struct Exchange {
    service: SessionServiceClient<Transport>,
    options: SessionOptions,
    /// Gone when the application has been told.
    opened: Option<oneshot::Sender<v1::SessionOpened>>,
    slots: Slots,
    frames: mpsc::UnboundedReceiver<FrameInput>,
    outcomes: mpsc::UnboundedSender<FrameOutcome>,
    window: Window,
    backoff: Backoff,
}

/// One connection of the session.
struct Link {
    requests: mpsc::Sender<v1::StreamRequest>,
    responses: Streaming<v1::StreamResponse>,
}

/// Sending fails from when the exchange is gone.
struct Slots(Arc<Semaphore>);

impl Drop for Slots {
    fn drop(&mut self) {
        self.0.close();
    }
}

impl Exchange {
    /// Also gives what tells that the session has been opened.
    pub(super) fn new(
        service: SessionServiceClient<Transport>,
        options: SessionOptions,
        slots: Arc<Semaphore>,
        frames: mpsc::UnboundedReceiver<FrameInput>,
        outcomes: mpsc::UnboundedSender<FrameOutcome>,
    ) -> (Self, oneshot::Receiver<v1::SessionOpened>) {
        let (opened, on_opened) = oneshot::channel();
        let jitter = ChaCha8Rng::seed_from_u64(RandomState::new().hash_one(()));
        let exchange = Self {
            service,
            backoff: Backoff::new(options.reconnection.clone(), jitter),
            options,
            opened: Some(opened),
            slots: Slots(slots),
            frames,
            outcomes,
            window: Window::default(),
        };
        (exchange, on_opened)
    }

    /// Until every frame has its outcome and no more come.
    pub(super) async fn run(mut self) -> Result<(), Error> {
        loop {
            let end = match self.connect().await {
                Ok(link) => self.converse(link).await,
                Err(end) => Err(end),
            };
            match end {
                Ok(()) => return Ok(()),
                Err(LinkEnd::Final(error)) => return Err(error),
                Err(LinkEnd::Broken(reason)) => {
                    self.window.send_again();
                    if self.is_finished() {
                        return Ok(());
                    }
                    let delay = self.next_delay(&reason)?;
                    self.tell_of_loss(&reason);
                    sleep(delay).await;
                }
            }
        }
    }

    /// Once loudly; that further attempts fail is no news.
    fn tell_of_loss(&self, reason: &str) {
        let attempted_for = self.backoff.waited(Instant::now());
        if attempted_for.is_zero() {
            let unacknowledged = self.window.len();
            tracing::warn!(
                "lost the server ({reason}); trying again for {} s, {unacknowledged} frames unacknowledged",
                self.options.reconnection.give_up_after.as_secs(),
            );
        } else {
            tracing::debug!("no server yet ({reason}) after {:.1} s", attempted_for.as_secs_f64());
        }
    }

    /// Opens the session, or opens it again.
    async fn connect(&mut self) -> Result<Link, LinkEnd> {
        // Room for the opening and a full window: a request never waits, nor is one ever too many.
        let (requests, queue) = mpsc::channel(self.options.window_frames.get().saturating_add(1));
        put(&requests, Request::Open(self.opening()))?;
        let opening = async {
            let mut responses = self.service.stream(ReceiverStream::new(queue)).await?.into_inner();
            let first = responses.message().await?;
            Ok((responses, first.and_then(|response| response.content)))
        };
        match link_end::opened("session", opening).await? {
            (responses, Some(Response::Opened(opened))) => {
                self.on_opened(opened)?;
                Ok(Link { requests, responses })
            }
            (_, None) => Err(LinkEnd::closed()),
            (_, Some(Response::Answer(_) | Response::Refusal(_))) => {
                Err(LinkEnd::Final(Error::Protocol("it answered before the session was opened")))
            }
        }
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

    /// Keeps the session's name for opening it again, and sees to it that nothing was forgotten.
    fn on_opened(&mut self, opened: v1::SessionOpened) -> Result<(), LinkEnd> {
        let Some((_, session_id)) = opened.session.rsplit_once('/') else {
            return Err(LinkEnd::Final(Error::Protocol("it named a session without its map")));
        };
        self.options.session_id = session_id.to_owned();
        // A server that was restarted knows nothing of a robot that only looked, and has lost nothing by it.
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
            // If nobody waits any more, the whole exchange is about to be dropped.
            Some(on_opened) => drop(on_opened.send(opened)),
            None => tracing::warn!("back at the server; sending {} frames again", self.window.len()),
        }
        Ok(())
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
                response = link.responses.message() => {
                    if let Some((reason, hint)) = self.on_response(response)? {
                        let at = match release_at {
                            Some(at) => at,
                            None => {
                                let delay = self.next_delay(&reason).map_err(LinkEnd::Final)?;
                                // A server that says when has kept the turn free, for a while.
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

    /// Gives reason and delay if the server asks to send a frame again.
    fn on_response(
        &mut self,
        response: Result<Option<v1::StreamResponse>, Status>,
    ) -> Result<Option<(String, Duration)>, LinkEnd> {
        let response = response.map_err(|status| LinkEnd::of(&status))?;
        let Some(v1::StreamResponse { content }) = response else {
            return Err(LinkEnd::closed());
        };
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
            // Whoever drops the receiver drops this exchange with it.
            let _ = self.outcomes.send(outcome);
            self.slots.0.add_permits(1);
        }
    }

    fn is_finished(&self) -> bool {
        self.window.len() == 0 && self.no_more_frames()
    }

    fn no_more_frames(&self) -> bool {
        self.frames.is_closed() && self.frames.is_empty()
    }

    fn next_delay(&mut self, reason: &str) -> Result<Duration, Error> {
        let now = Instant::now();
        self.backoff.next_delay(now).ok_or_else(|| Error::SessionLost {
            unacknowledged: self.window.len() + self.frames.len(),
            waited: self.backoff.waited(now),
            reason: reason.to_owned(),
        })
    }
}

fn put(requests: &mpsc::Sender<v1::StreamRequest>, content: Request) -> Result<(), LinkEnd> {
    let request = v1::StreamRequest { content: Some(content) };
    match requests.try_send(request) {
        // Closed: the call is over, and its responses tell why.
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
