//! Navigation: the server steers a robot along a map.
//!
//! The application reports odometry and sends frames. A background task talks to the server and
//! reconnects when the connection breaks. A command is valid for half a second; after that
//! [`Navigation::command`] returns a stop, so a robot without a server stands still.

use std::sync::{Arc, Mutex};

use tokio::sync::{mpsc, oneshot, watch};
use waypost_proto::v1;
use waypost_proto::v1::navigate_request::Content as Request;

pub use command::Command;
pub use event::NavigationEvent;
pub use options::NavigationOptions;

use crate::client::{Call, Client};
use crate::error::Error;
use crate::frame::FrameInput;
use crate::reconnection::{Backoff, Task, random_seed};
use asked::AskedGoals;
use command::{LastCommand, lock};
use exchange::{MESSAGES_AHEAD, NavigationExchange};

mod asked;
mod command;
mod event;
mod exchange;
mod options;

/// Events that wait for the application; later ones are dropped.
const EVENTS_AHEAD: usize = 1024;

/// One reading of the wheels.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Time of the reading by the robot's monotonic clock, in nanoseconds. Above 0 and rising.
    pub stamp_ns: i64,
    /// The robot's pose by its wheels.
    pub odometry: v1::Odometry,
    /// Whether a reflex of the robot (an emergency stop, for example) overrides the commands.
    pub reflex: bool,
}

/// A navigation in progress. Dropping it ends the navigation; the robot must stop then.
#[derive(Debug)]
pub struct Navigation {
    opened: v1::NavigationOpened,
    messages: mpsc::Sender<Request>,
    events: mpsc::Receiver<NavigationEvent>,
    guidance: watch::Receiver<Option<v1::Guidance>>,
    last_command: Arc<Mutex<LastCommand>>,
    exchange: Task,
}

impl Client {
    /// Starts a navigation and waits until the server has opened it.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT without a camera, FAILED_PRECONDITION if
    /// another stream steers the robot or robots cannot navigate in this map.
    pub fn navigate(&self, options: NavigationOptions) -> Call<'_, Navigation> {
        Box::pin(async move {
            let (messages, to_send) = mpsc::channel(MESSAGES_AHEAD);
            let (told, events) = mpsc::channel(EVENTS_AHEAD);
            let (guided, guidance) = watch::channel(None);
            let last_command = Arc::new(Mutex::new(LastCommand::default()));
            let (on_opened, opened) = oneshot::channel();
            let mut exchange = Task::spawn(NavigationExchange {
                service: self.navigations_client(),
                // By this the server tells a robot that reconnects from another one of the same name.
                run_id: format!("run-{:016x}", random_seed()),
                asked: AskedGoals::new(options.goal.clone()),
                backoff: Backoff::new(options.reconnection.clone()),
                options,
                opened: Some(on_opened),
                to_send,
                told,
                guided,
                last_command: last_command.clone(),
            });
            let opened = exchange.opened(opened).await?;
            Ok(Navigation { opened, messages, events, guidance, last_command, exchange })
        })
    }
}

impl Navigation {
    /// The name of the navigation, and the model that words are made with.
    pub fn opened(&self) -> &v1::NavigationOpened {
        &self.opened
    }

    /// The command to drive by now: the last one while it is valid, and a stop as soon as it is
    /// not. Call it in every cycle of the motor controller.
    pub fn command(&self) -> Command {
        lock(&self.last_command).obey()
    }

    /// Reports odometry, 10 to 50 times a second; the server answers with the next command. Without
    /// a connection the report is dropped.
    pub fn report(&self, Reading { stamp_ns, odometry, reflex }: Reading) {
        let obeyed_number = lock(&self.last_command).obeyed();
        let report = v1::WheelReport { stamp_ns, odometry: Some(odometry), obeyed_number, reflex };
        let _ = self.messages.try_send(Request::Wheels(report));
    }

    /// Reports for a robot without odometry, which navigates by appearance, whether a reflex
    /// overrides the commands, 10 to 50 times a second; the server answers with the next command.
    /// Without a connection the report is dropped.
    pub fn report_reflex(&self, stamp_ns: i64, reflex: bool) {
        let obeyed_number = lock(&self.last_command).obeyed();
        let report = v1::WheelReport { stamp_ns, odometry: None, obeyed_number, reflex };
        let _ = self.messages.try_send(Request::Wheels(report));
    }

    /// Sends a frame; [`NavigationEvent::Seen`] says what it showed. With odometry about twice a
    /// second; by appearance a panorama four times a second, without odometry, which the server
    /// also answers with a command. Without a connection the frame is dropped.
    pub fn see(&self, frame: FrameInput) {
        let _ = self.messages.try_send(Request::Frame(frame.into()));
    }

    /// Sets another goal. Waits while the queue to the server is full.
    ///
    /// # Errors
    /// If the navigation is over, the reason: see [`Navigation::next`].
    pub async fn go_to(&mut self, goal: v1::Goal) -> Result<(), Error> {
        self.send(Request::Goal(goal)).await
    }

    /// Gives up the goal: the robot stops.
    ///
    /// # Errors
    /// As [`go_to`](Self::go_to).
    pub async fn stop(&mut self) -> Result<(), Error> {
        // Now, however long the queue to the server is.
        lock(&self.last_command).forget();
        self.send(Request::Stop(v1::StopNavigation {})).await
    }

    /// The last guidance: command, status, the robot's position. The receiver can wait for a new
    /// one.
    pub fn guidance(&self) -> watch::Receiver<Option<v1::Guidance>> {
        self.guidance.clone()
    }

    /// Waits for the next event; none when the navigation is over. At most 1024 events wait to be
    /// taken, further ones are dropped.
    ///
    /// # Errors
    /// The reason why the navigation is over: [`Error::Status`] with ABORTED if the same run opened
    /// another stream, [`Error::SessionLost`] if the server did not come back.
    pub async fn next(&mut self) -> Result<Option<NavigationEvent>, Error> {
        match self.events.recv().await {
            Some(event) => Ok(Some(event)),
            None => self.exchange.ending().await.map(|()| None),
        }
    }

    /// The next event if there is one already.
    pub fn try_next(&mut self) -> Option<NavigationEvent> {
        self.events.try_recv().ok()
    }

    async fn send(&mut self, message: Request) -> Result<(), Error> {
        match self.messages.send(message).await {
            Ok(()) => Ok(()),
            Err(_closed) => self.exchange.ending().await,
        }
    }
}
