//! The task that keeps a navigation going: connect, send, receive, and again.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::sleep;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use waypost_proto::v1;
use waypost_proto::v1::navigate_request::Content as Request;
use waypost_proto::v1::navigate_response::Content as Response;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;

use super::{Held, MESSAGES_AHEAD, NavigationEvent, NavigationOptions, lock};
use crate::client::Transport;
use crate::error::Error;
use crate::link_end::{self, LinkEnd};
use crate::session::backoff::Backoff;

/// What it works with.
pub(super) struct Exchange {
    pub(super) service: NavigationServiceClient<Transport>,
    pub(super) options: NavigationOptions,
    pub(super) run_id: String,
    /// Gone when the application has been told.
    pub(super) opened: Option<oneshot::Sender<v1::NavigationOpened>>,
    pub(super) to_send: mpsc::Receiver<Request>,
    pub(super) told: mpsc::Sender<NavigationEvent>,
    pub(super) guided: watch::Sender<Option<v1::Guidance>>,
    pub(super) held: Arc<Mutex<Held>>,
    pub(super) backoff: Backoff,
}

/// One connection.
struct Link {
    requests: mpsc::Sender<v1::NavigateRequest>,
    responses: Streaming<v1::NavigateResponse>,
}

impl Exchange {
    /// Until the application drops the navigation.
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
                    let now = tokio::time::Instant::now();
                    if self.backoff.waited(now).is_zero() && self.opened.is_none() {
                        self.tell(NavigationEvent::Disconnected { reason: reason.clone() });
                    }
                    let Some(delay) = self.backoff.next_delay(now) else {
                        let waited = self.backoff.waited(now);
                        return Err(Error::SessionLost { unacknowledged: 0, waited, reason });
                    };
                    sleep(delay).await;
                }
            }
        }
    }

    async fn connect(&mut self) -> Result<Link, LinkEnd> {
        let (requests, queue) = mpsc::channel(MESSAGES_AHEAD);
        let opening = v1::NavigateRequest { content: Some(Request::Open(self.opening())) };
        // The queue is empty: there is room.
        let _ = requests.try_send(opening);
        let opening = async {
            let mut responses = self.service.navigate(ReceiverStream::new(queue)).await?.into_inner();
            let first = responses.message().await?;
            Ok((responses, first.and_then(|response| response.content)))
        };
        match link_end::opened("navigation", opening).await? {
            (responses, Some(Response::Opened(opened))) => {
                let link = Link { requests, responses };
                // Before the application hears of it: what it sends from then on is not late.
                if let Some(goal) = self.last_goal_that_waited() {
                    self.remember(&goal);
                    put(&link, goal).await;
                }
                self.on_opened(opened)?;
                Ok(link)
            }
            (_, None) => Err(LinkEnd::closed()),
            (_, Some(_)) => {
                Err(LinkEnd::Final(Error::Protocol("it answered before the navigation was opened")))
            }
        }
    }

    fn opening(&self) -> v1::OpenNavigation {
        let NavigationOptions { map, navigation_id, camera, words_hash, goal, driving, reconnection: _ } =
            &self.options;
        v1::OpenNavigation {
            map: map.clone(),
            navigation_id: navigation_id.clone(),
            run_id: self.run_id.clone(),
            camera: Some(camera.clone()),
            words_hash: words_hash.clone(),
            goal: goal.clone(),
            driving: Some(*driving),
        }
    }

    fn on_opened(&mut self, opened: v1::NavigationOpened) -> Result<(), LinkEnd> {
        let Some((_, name)) = opened.navigation.rsplit_once('/') else {
            return Err(LinkEnd::Final(Error::Protocol("it named a navigation without its map")));
        };
        self.options.navigation_id = name.to_owned();
        self.backoff.progress();
        let resumed = opened.resumed;
        match self.opened.take() {
            // If nobody waits any more, the whole exchange is about to be dropped.
            Some(on_opened) => drop(on_opened.send(opened)),
            None => self.tell(NavigationEvent::Reconnected { resumed }),
        }
        Ok(())
    }

    async fn converse(&mut self, mut link: Link) -> Result<(), LinkEnd> {
        loop {
            tokio::select! {
                message = self.to_send.recv() => match message {
                    Some(message) => {
                        self.remember(&message);
                        put(&link, message).await;
                    }
                    None => return Ok(()),
                },
                response = link.responses.message() => {
                    let response = response.map_err(|status| LinkEnd::of(&status))?;
                    let Some(content) = response.and_then(|response| response.content) else {
                        return Err(LinkEnd::closed());
                    };
                    self.on_response(content)?;
                }
            }
        }
    }

    /// What waited for the connection is of a moment long past; a goal is not.
    fn last_goal_that_waited(&mut self) -> Option<Request> {
        let mut last = None;
        while let Ok(message) = self.to_send.try_recv() {
            if let Request::Goal(_) | Request::ImageGoal(_) | Request::Stop(_) = message {
                last = Some(message);
            }
        }
        last
    }

    /// A server that was started anew is to be told the goal again.
    fn remember(&mut self, message: &Request) {
        match message {
            Request::Goal(goal) => self.options.goal = Some(goal.clone()),
            // Which place it is, the server alone knows: after a start anew it is to be asked for again.
            Request::Stop(_) | Request::ImageGoal(_) => self.options.goal = None,
            Request::Open(_) | Request::Wheels(_) | Request::Frame(_) => {}
        }
    }

    fn on_response(&mut self, content: Response) -> Result<(), LinkEnd> {
        match content {
            Response::Guidance(guidance) => {
                if let Some(command) = guidance.command {
                    lock(&self.held).command = Some((command, Instant::now()));
                }
                self.guided.send_replace(Some(guidance));
            }
            Response::Seen(seen) => self.tell(NavigationEvent::Seen(seen)),
            Response::Refusal(refusal) => self.tell(NavigationEvent::FrameRefused(refusal)),
            Response::WheelRefusal(refusal) => self.tell(NavigationEvent::WheelsRefused(refusal)),
            Response::GoalRefusal(refusal) => {
                self.options.goal = None;
                self.tell(NavigationEvent::GoalRefused(refusal));
            }
            Response::Opened(_) => {
                return Err(LinkEnd::Final(Error::Protocol("it opened the navigation twice")));
            }
        }
        Ok(())
    }

    fn tell(&self, event: NavigationEvent) {
        let _ = self.told.try_send(event);
    }
}

/// Wheels and frames that do not fit are dropped: a robot that drives has no use for what is late.
async fn put(link: &Link, content: Request) {
    let is_goal = matches!(content, Request::Goal(_) | Request::ImageGoal(_) | Request::Stop(_));
    let message = v1::NavigateRequest { content: Some(content) };
    // If the call is over, its responses tell why.
    if is_goal {
        let _ = link.requests.send(message).await;
    } else {
        let _ = link.requests.try_send(message);
    }
}
