//! A robot that is led along a map.
//!
//! The application reports odometry and hands frames over; a task of its own talks to the server, and comes back after a
//! broken connection. Meanwhile [`Navigation::command`] says to stop: a command holds for half a second.

use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use waypost_proto::v1;
use waypost_proto::v1::navigate_request::Content as Request;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;

use crate::client::{Client, Transport, map_name};
use crate::error::Error;
use crate::session::backoff::Backoff;
use crate::session::{FrameContent, FrameInput, Reconnection};
use exchange::Exchange;

mod exchange;
mod requests;

/// Messages that wait to be sent; what is older is of no use to a robot that drives.
const MESSAGES_AHEAD: usize = 64;

/// Events that wait for the application.
const EVENTS_AHEAD: usize = 1024;

/// Whom to lead, and how.
#[derive(Clone, Debug)]
pub struct NavigationOptions {
    /// `{map}` or `maps/{map}`.
    pub map: String,
    /// Name of the robot. If empty, the server makes one up.
    pub navigation_id: String,
    /// How the robot sees; its field of view, or a calibration, is needed. On a map that is navigated by appearance, a
    /// panorama or a hyperbolic mirror.
    pub camera: v1::Camera,
    /// `words_hash` of the model that the robot makes its words with; empty for one that sends images.
    pub words_hash: String,
    /// Where to go at first.
    pub goal: Option<v1::Goal>,
    /// How to drive.
    pub driving: v1::DrivingSettings,
    /// How a broken connection is mended.
    pub reconnection: Reconnection,
}

impl NavigationOptions {
    /// A robot that stands until it has a goal, with all defaults.
    pub fn new(map: &str, camera: v1::Camera) -> Self {
        Self {
            map: map_name(map),
            navigation_id: String::new(),
            camera,
            words_hash: String::new(),
            goal: None,
            driving: v1::DrivingSettings::default(),
            reconnection: Reconnection::default(),
        }
    }
}

/// What the robot is to do at this moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Speed ahead, in m/s.
    pub forward_m_s: f64,
    /// Turn to the left, in rad/s.
    pub turn_rad_s: f64,
}

/// What the wheels say.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// By the robot's own steady clock, in nanoseconds above 0, rising.
    pub stamp_ns: i64,
    /// Where they put the robot.
    pub odometry: v1::Odometry,
    /// Whether the robot's own reflex drives at the moment.
    pub reflex: bool,
}

/// What the server says, besides commands.
#[derive(Clone, Debug, PartialEq)]
pub enum NavigationEvent {
    /// What a frame showed.
    Seen(v1::FrameSeen),
    /// A frame was not taken.
    FrameRefused(v1::FrameRefusal),
    /// A wheel report was not taken.
    WheelsRefused(v1::WheelRefusal),
    /// The robot is not led to that goal.
    GoalRefused(v1::GoalRefusal),
    /// The connection broke; another attempt follows.
    Disconnected {
        /// Why.
        reason: String,
    },
    /// The connection is back; where the server was started anew, nothing of before is known there.
    Reconnected {
        /// Whether the navigation goes on where it was.
        resumed: bool,
    },
}

/// A robot that is being led. Dropping it ends that: the robot is to stop then.
#[derive(Debug)]
pub struct Navigation {
    opened: v1::NavigationOpened,
    messages: mpsc::Sender<Request>,
    events: mpsc::Receiver<NavigationEvent>,
    guidance: watch::Receiver<Option<v1::Guidance>>,
    held: Arc<Mutex<Held>>,
    exchange: Option<JoinHandle<Result<(), Error>>>,
}

/// The last command, and when it came.
#[derive(Debug, Default)]
struct Held {
    command: Option<(v1::VelocityCommand, Instant)>,
    /// Number of the last one that the application took to drive by.
    obeyed: Option<u64>,
}

impl Client {
    /// Begins to lead a robot along a map.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT without a camera, FAILED_PRECONDITION if another stream leads the
    /// robot, or the map cannot steer one.
    pub async fn navigate(&self, options: NavigationOptions) -> Result<Navigation, Error> {
        Navigation::open(self.navigations_client(), options).await
    }
}

impl Navigation {
    async fn open(
        service: NavigationServiceClient<Transport>,
        options: NavigationOptions,
    ) -> Result<Self, Error> {
        let (messages, to_send) = mpsc::channel(MESSAGES_AHEAD);
        let (told, events) = mpsc::channel(EVENTS_AHEAD);
        let (guided, guidance) = watch::channel(None);
        let held = Arc::new(Mutex::new(Held::default()));
        let (on_opened, opened) = oneshot::channel();
        let seed = RandomState::new().hash_one(());
        let exchange = Exchange {
            service,
            // Tells this robot, come back, from another by its name.
            run_id: format!("run-{seed:016x}"),
            backoff: Backoff::new(options.reconnection.clone(), ChaCha8Rng::seed_from_u64(seed)),
            options,
            opened: Some(on_opened),
            to_send,
            told,
            guided,
            held: held.clone(),
        };
        let exchange = tokio::spawn(exchange.run());
        match opened.await {
            Ok(opened) => Ok(Self { opened, messages, events, guidance, held, exchange: Some(exchange) }),
            Err(_never_opened) => {
                exchange.await.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()))?;
                Err(Error::Protocol("the navigation ended before it was opened"))
            }
        }
    }

    /// The name of the navigation, and the model that words are made with.
    pub fn opened(&self) -> &v1::NavigationOpened {
        &self.opened
    }

    /// What to do now, for whoever drives the wheels, as often as they can: the last command while it is valid, and to
    /// stand still as soon as it is not.
    pub fn command(&self) -> Command {
        let mut held = lock(&self.held);
        let valid = held.command.as_ref().and_then(|(command, since)| {
            let valid = Duration::from_nanos(u64::try_from(command.valid_ns).unwrap_or(0));
            (since.elapsed() < valid).then_some(*command)
        });
        let Some(v1::VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns: _ }) = valid else {
            return Command::default();
        };
        held.obeyed = Some(number);
        Command { forward_m_s, turn_rad_s }
    }

    /// Reports what the wheels say, 10 to 50 times a second; the next command comes of it. Without a connection it is
    /// dropped.
    pub fn report(&self, Reading { stamp_ns, odometry, reflex }: Reading) {
        let obeyed_number = lock(&self.held).obeyed;
        let report = v1::WheelReport { stamp_ns, odometry: Some(odometry), obeyed_number, reflex };
        let _ = self.messages.try_send(Request::Wheels(report));
    }

    /// Reports of a robot without wheels, by appearance, whether its own reflex drives at the moment, 10 to 50 times a second;
    /// the next command comes of it. Without a connection it is dropped.
    pub fn report_reflex(&self, stamp_ns: i64, reflex: bool) {
        let obeyed_number = lock(&self.held).obeyed;
        let report = v1::WheelReport { stamp_ns, odometry: None, obeyed_number, reflex };
        let _ = self.messages.try_send(Request::Wheels(report));
    }

    /// Hands a frame with odometry over, twice a second or so; by appearance a panorama, four times a second, that needs
    /// none: a command comes of it, too. [`NavigationEvent::Seen`] says what it showed. Without a
    /// connection it is dropped.
    pub fn see(&self, frame: FrameInput) {
        let FrameInput { sequence, stamp_ns, content, odometry } = frame;
        let content = match content {
            FrameContent::Image(image) => v1::frame::Content::Image(image),
            FrameContent::Histogram(histogram) => v1::frame::Content::Histogram(histogram),
            FrameContent::Words(words) => v1::frame::Content::Words(words),
        };
        let frame = v1::Frame { sequence, stamp_ns, odometry, content: Some(content) };
        let _ = self.messages.try_send(Request::Frame(frame));
    }

    /// Goes to another goal; waits while messages pile up.
    ///
    /// # Errors
    /// Why the navigation is over, if it is: see [`Navigation::next`].
    pub async fn go_to(&mut self, goal: v1::Goal) -> Result<(), Error> {
        match self.messages.send(Request::Goal(goal)).await {
            Ok(()) => Ok(()),
            Err(_closed) => self.ending().await,
        }
    }

    /// Goes to where a panorama was taken, a JPEG or PNG, by appearance; waits while messages pile up.
    ///
    /// # Errors
    /// As [`go_to`](Self::go_to).
    pub async fn go_to_image(&mut self, image: Vec<u8>) -> Result<(), Error> {
        match self.messages.send(Request::ImageGoal(v1::ImageGoal { image })).await {
            Ok(()) => Ok(()),
            Err(_closed) => self.ending().await,
        }
    }

    /// Has no goal any more: the robot stops.
    ///
    /// # Errors
    /// As [`go_to`](Self::go_to).
    pub async fn stop(&mut self) -> Result<(), Error> {
        match self.messages.send(Request::Stop(v1::StopNavigation {})).await {
            Ok(()) => Ok(()),
            Err(_closed) => self.ending().await,
        }
    }

    /// The last guidance: command, status, where the robot is. Its receiver says when there is a new one.
    pub fn guidance(&self) -> watch::Receiver<Option<v1::Guidance>> {
        self.guidance.clone()
    }

    /// What happened next. Events that nobody takes are dropped beyond a thousand.
    ///
    /// # Errors
    /// Why the navigation is over: [`Error::Status`] with ABORTED if the same run opened another stream,
    /// [`Error::SessionLost`] if the server did not come back.
    pub async fn next(&mut self) -> Result<Option<NavigationEvent>, Error> {
        match self.events.recv().await {
            Some(event) => Ok(Some(event)),
            None => self.ending().await.map(|()| None),
        }
    }

    /// As [`next`](Self::next), if something has happened already.
    pub fn try_next(&mut self) -> Option<NavigationEvent> {
        self.events.try_recv().ok()
    }

    async fn ending(&mut self) -> Result<(), Error> {
        match self.exchange.take() {
            Some(exchange) => {
                exchange.await.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()))
            }
            None => Ok(()),
        }
    }
}

fn lock(held: &Mutex<Held>) -> MutexGuard<'_, Held> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}
