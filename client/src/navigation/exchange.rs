//! The task that keeps a navigation going: connect, send, receive, and again.

use std::sync::{Arc, Mutex};

use tokio::sync::{mpsc, oneshot, watch};
use waypost_proto::v1;
use waypost_proto::v1::navigate_request::Content as Request;
use waypost_proto::v1::navigate_response::Content as Response;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;

use super::asked::AskedGoals;
use super::command::{LastCommand, lock};
use super::event::NavigationEvent;
use super::options::NavigationOptions;
use crate::client::Transport;
use crate::error::Error;
use crate::reconnection::{self, Backoff, Exchange, LinkEnd};

/// Messages that wait to be sent. More would be too old to be of use to a moving robot.
pub(super) const MESSAGES_AHEAD: usize = 64;

type Link = reconnection::Link<v1::NavigateRequest, v1::NavigateResponse>;

/// This side of a navigation.
pub(super) struct NavigationExchange {
    pub(super) service: NavigationServiceClient<Transport>,
    pub(super) options: NavigationOptions,
    pub(super) run_id: String,
    pub(super) asked: AskedGoals,
    /// None once the application knows that the navigation is open.
    pub(super) opened: Option<oneshot::Sender<v1::NavigationOpened>>,
    pub(super) to_send: mpsc::Receiver<Request>,
    pub(super) told: mpsc::Sender<NavigationEvent>,
    pub(super) guided: watch::Sender<Option<v1::Guidance>>,
    pub(super) last_command: Arc<Mutex<LastCommand>>,
    pub(super) backoff: Backoff,
}

impl NavigationExchange {
    fn opening(&self) -> v1::OpenNavigation {
        let NavigationOptions { map, navigation_id, camera, words_hash, goal: _, driving, reconnection: _ } =
            &self.options;
        v1::OpenNavigation {
            map: map.clone(),
            navigation_id: navigation_id.clone(),
            run_id: self.run_id.clone(),
            camera: Some(camera.clone()),
            words_hash: words_hash.clone(),
            goal: self.asked.for_opening(),
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
            // If the application no longer waits, it has dropped the navigation.
            Some(on_opened) => drop(on_opened.send(opened)),
            None => self.tell(NavigationEvent::Reconnected { resumed }),
        }
        Ok(())
    }

    /// Of the messages that waited for the connection only goals count; the others are too old.
    fn note_what_waited(&mut self) {
        while let Ok(message) = self.to_send.try_recv() {
            self.note(&message);
        }
    }

    fn note(&mut self, message: &Request) {
        match message {
            Request::Goal(goal) => self.asked.go_to(goal.clone()),
            Request::Stop(_) => {
                self.asked.stop();
                lock(&self.last_command).forget();
            }
            Request::Wheels(report) => self.asked.stamped(report.stamp_ns),
            Request::Frame(frame) => self.asked.stamped(frame.stamp_ns),
            Request::Open(_) => {}
        }
    }

    fn on_response(&mut self, content: Response) -> Result<(), LinkEnd> {
        match content {
            Response::Guidance(guidance) => {
                self.asked.guided(&guidance);
                // The server may give commands that it would not give if it knew of the stop.
                if let Some(command) = guidance.command
                    && !self.asked.is_stopping()
                {
                    lock(&self.last_command).set(command);
                }
                self.guided.send_replace(Some(guidance));
            }
            Response::Seen(seen) => self.tell(NavigationEvent::Seen(seen)),
            Response::Refusal(refusal) => self.tell(NavigationEvent::FrameRefused(refusal)),
            Response::WheelRefusal(refusal) => self.tell(NavigationEvent::WheelsRefused(refusal)),
            Response::GoalRefusal(refusal) => {
                self.asked.refused(refusal.goal.as_ref());
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

impl Exchange for NavigationExchange {
    type Link = Link;

    async fn connect(&mut self) -> Result<Link, LinkEnd> {
        let opening = v1::NavigateRequest { content: Some(Request::Open(self.opening())) };
        let (link, first) =
            Link::open(MESSAGES_AHEAD, opening, |requests| self.service.navigate(requests)).await?;
        match first.content {
            Some(Response::Opened(opened)) => {
                // Before the application is told, since what it sends from then on is up to date.
                self.note_what_waited();
                for message in self.asked.unsaid() {
                    put(&link, message).await;
                }
                self.on_opened(opened).map(|()| link)
            }
            None => Err(LinkEnd::closed()),
            Some(_) => Err(LinkEnd::Final(Error::Protocol("it answered before the navigation was opened"))),
        }
    }

    async fn converse(&mut self, mut link: Link) -> Result<(), LinkEnd> {
        loop {
            tokio::select! {
                message = self.to_send.recv() => match message {
                    Some(message) => {
                        self.note(&message);
                        put(&link, message).await;
                    }
                    None => return Ok(()),
                },
                response = link.next() => {
                    self.on_response(response?.content.ok_or_else(LinkEnd::closed)?)?;
                }
            }
        }
    }

    fn on_broken(&mut self, reason: &str) {
        if !self.backoff.is_in_trouble() && self.opened.is_none() {
            self.tell(NavigationEvent::Disconnected { reason: reason.to_owned() });
        }
    }

    fn is_finished(&self) -> bool {
        false
    }

    fn unacknowledged(&self) -> usize {
        0
    }

    fn backoff(&mut self) -> &mut Backoff {
        &mut self.backoff
    }
}

/// Sends a message. Wheel reports and frames that do not fit are dropped: late ones are of no use.
async fn put(link: &Link, content: Request) {
    let is_goal = matches!(content, Request::Goal(_) | Request::Stop(_));
    let message = v1::NavigateRequest { content: Some(content) };
    // If the call is over, its responses say why.
    if is_goal {
        let _ = link.requests.send(message).await;
    } else {
        let _ = link.requests.try_send(message);
    }
}
