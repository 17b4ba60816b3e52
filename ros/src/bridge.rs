//! The whole: who reads what from the robot, who tells it what, and how all of it ends.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval};
use waypost_bags::Kind;
use waypost_client::v1::MapView;
use waypost_client::{Client, ClientOptions, Code, Error};

use crate::bus::{Bus, Outgoing, Qos};
use crate::control::Control;
use crate::diagnostics::Report;
use crate::drive::{Drive, goals, wishes};
use crate::failure::Failure;
use crate::intake::Intake;
use crate::markers::Markers;
use crate::nav2::{Action, Nav2};
use crate::outbox::Outbox;
use crate::peers::Peers;
use crate::plan::Plan;
use crate::robot_words::{ContentMaker, SessionError};
use crate::session::Streaming;
use crate::sessions::Sessions;
use crate::settings::{Mode, Settings};
use crate::shown::Shown;
use crate::state::{Declared, Shared};
use crate::telling::{Sureness, Telling};
use crate::tf::TfThread;
use crate::viewers::Viewers;
use waypost_ros_messages::{Covariance, DiagnosticArray};

const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);
/// Without an image for so long it is said which topics have some.
const IMAGES_PATIENCE: Duration = Duration::from_secs(8);
/// For the robot to stand when the bridge ends.
const LAST_STOP: Duration = Duration::from_secs(2);
/// For what is still at work to end.
const LAST_WORK: Duration = Duration::from_secs(2);
const ODOMETRY: &str = "nav_msgs::msg::dds_::Odometry_";
const CAMERA_INFO: &str = "sensor_msgs::msg::dds_::CameraInfo_";
const TRANSFORMS: &str = "tf2_msgs::msg::dds_::TFMessage_";

type Unanswered = Arc<Mutex<VecDeque<(u64, i64)>>>;

/// What the parts of the bridge have in common.
struct Parts {
    settings: Settings,
    client: Client,
    shared: Shared,
    outbox: Arc<Outbox>,
    intake: Arc<Intake>,
    unanswered: Unanswered,
    declared: watch::Receiver<Declared>,
    plans: watch::Sender<Plan>,
    ending: watch::Receiver<bool>,
}

/// Runs the bridge until it is told to end, or cannot go on.
///
/// # Errors
/// [`Failure`], by its kind.
pub(crate) async fn run(settings: Settings) -> Result<(), Failure> {
    let client = Client::lazy(client_options(&settings).await?)?;
    let shared = Shared::default();
    let viewers = match settings.foxglove {
        Some(address) => Some(Arc::new(Viewers::open(address, shared.clone()).await?)),
        None => None,
    };
    let peers = Peers::find(settings.domain, &settings.peers).await?;
    let mut bus = Bus::join(settings.domain, &settings.networks, viewers.clone())?;
    let (end, ending) = watch::channel(false);
    let parts = parts(settings, client, shared, viewers.as_deref(), ending)?;
    let mut tasks = listen(&parts, &mut bus)?;
    if let Some(peers) = peers {
        tasks.push(tokio::spawn(peers.tell(bus.prefix())));
    }
    let driving = match parts.settings.mode {
        Mode::Drive => Some(drive(&parts, &mut bus, &mut tasks)?),
        Mode::Map | Mode::Localize => None,
    };
    if parts.settings.is_served {
        tasks.extend(control(&parts).serve(&bus)?);
    }
    let settings = parts.settings.clone();
    let outbox = parts.outbox.clone();
    let client = parts.client.clone();
    let membership = bus.membership();
    let sessions = sessions(&parts, &bus)?;
    let tf = bus.write(&settings.topics.tf, Qos::Reliable)?;
    let tf = TfThread::start(parts.shared.clone(), tf, settings.map_frame.clone())?;
    tasks.push(tokio::spawn(markers(&parts, &bus)?.run()));
    let reporting = reporting(&parts, bus)?;
    tasks.push(tokio::spawn(reporting.bus.presence(&settings.namespace)?.tell()));
    tasks.push(tokio::spawn(reporting.run()));
    drop(parts);

    tasks.push(tokio::spawn(first_look(client, settings.clone())));
    tracing::info!(
        "listening in domain {} for {}; {} at {}",
        settings.domain,
        settings.topics.image,
        settings.map.as_ref().map_or_else(|| "no map is chosen yet".to_owned(), |map| format!("map {map}")),
        settings.server
    );
    let is_whole = || !tf.is_over() && driving.as_ref().is_none_or(|driving| !driving.is_finished());
    let ended = until_told(sessions.run(&settings), &end, is_whole).await;
    end.send_replace(true);
    let left = outbox.clear();
    if left > 0 {
        tracing::warn!("{left} frames that were not sent are lost");
    }
    if let Some(mut driving) = driving {
        // It has told of its own panic.
        if tokio::time::timeout(LAST_STOP, &mut driving).await.is_err() {
            tasks.push(driving);
        }
    }
    end_all(tasks).await;
    tf.stop();
    if let Some(viewers) = viewers {
        viewers.close().await;
    }
    membership.farewell().await;
    ended
}

/// Says at once what is wrong with the server or the map, which would be heard only when the first session is opened. The bridge
/// goes on: either may be there by then.
async fn first_look(client: Client, settings: Settings) {
    let Some(map) = &settings.map else { return };
    match client.map(map, MapView::Basic).await {
        // A token may be good for streams and not for looking.
        Ok(_) | Err(Error::Status { code: Code::PermissionDenied, .. }) => {}
        Err(error) => tracing::warn!("{error}; images wait until that is mended"),
    }
}

/// Ends tasks, and waits until they have ended: each has readers or writers, which say farewell when they are dropped.
async fn end_all(tasks: Vec<JoinHandle<()>>) {
    tasks.iter().for_each(JoinHandle::abort);
    if tokio::time::timeout(LAST_WORK, futures::future::join_all(tasks)).await.is_err() {
        tracing::debug!("some work does not end");
    }
}

fn parts(
    settings: Settings,
    client: Client,
    shared: Shared,
    viewers: Option<&Viewers>,
    ending: watch::Receiver<bool>,
) -> Result<Parts, Failure> {
    let outbox = Arc::new(Outbox::new());
    let (declaring, declared) = watch::channel(Declared::default());
    let topics = settings.topics.clone();
    let shown = viewers.map(|viewers| Shown::to(viewers, &topics)).transpose()?;
    let (plans, _) = watch::channel(Plan::first(&settings));
    let intake = Intake::new(
        shared.clone(),
        topics,
        settings.most_hz,
        outbox.clone(),
        declaring,
        plans.clone(),
        shown,
    );
    let (intake, unanswered) = (Arc::new(intake), Unanswered::default());
    Ok(Parts { settings, client, shared, outbox, intake, unanswered, declared, plans, ending })
}

async fn client_options(settings: &Settings) -> Result<ClientOptions, Failure> {
    let mut options = ClientOptions::new(&settings.server);
    if let Some(token) = &settings.token {
        options = options.with_token(token);
    }
    if let Some(path) = &settings.ca {
        let read = tokio::fs::read(path).await;
        options =
            options.with_ca(read.map_err(|source| Failure::Certificate { path: path.clone(), source })?);
    }
    Ok(options)
}

/// Subscribes to all that comes from the robot.
fn listen(Parts { intake, settings, .. }: &Parts, bus: &mut Bus) -> Result<Vec<JoinHandle<()>>, Failure> {
    let topics = &settings.topics;
    let sensor = Qos::Sensor(settings.sensor_qos);
    let image = match topics.image_kind {
        Kind::CompressedImage => "sensor_msgs::msg::dds_::CompressedImage_",
        _ => "sensor_msgs::msg::dds_::Image_",
    };
    let images = bus.read(&topics.image, image, sensor)?;
    let mut tasks = vec![tokio::spawn(intake.clone().images(images))];
    if let Some(topic) = &topics.odometry {
        tasks.push(tokio::spawn(intake.clone().odometry(bus.read(topic, ODOMETRY, sensor)?)));
    }
    if let Some(topic) = &topics.camera_info {
        tasks.push(tokio::spawn(intake.clone().camera_infos(bus.read(topic, CAMERA_INFO, sensor)?)));
        let latched = bus.read(&topics.tf_static, TRANSFORMS, Qos::Latched)?;
        tasks.push(tokio::spawn(intake.clone().mountings(latched)));
    }
    tasks.push(tokio::spawn(intake.clone().declare()));
    Ok(tasks)
}

/// Subscribes to goals, and begins to drive.
fn drive(parts: &Parts, bus: &mut Bus, tasks: &mut Vec<JoinHandle<()>>) -> Result<JoinHandle<()>, Failure> {
    let Parts { settings, client, shared, intake, declared, plans, ending, .. } = parts;
    let topics = &settings.topics;
    // Nav2 takes goals in metres itself.
    let poses = if settings.is_by_nav2 {
        Box::pin(futures::stream::pending())
    } else {
        bus.read(&topics.goal_pose, "geometry_msgs::msg::dds_::PoseStamped_", Qos::Reliable)?
    };
    let names = bus.read(&topics.goal, "std_msgs::msg::dds_::String_", Qos::Reliable)?;
    let (wished, wishes) = wishes();
    tasks.push(tokio::spawn(goals(poses, names, settings.map_frame.clone(), shared.clone(), wished)));
    if settings.is_by_nav2 {
        let nav2 = Nav2 {
            client: client.clone(),
            shared: shared.clone(),
            plans: plans.subscribe(),
            map_frame: settings.map_frame.clone(),
            action: Action::of(bus, &topics.navigate_to_pose)?,
            wishes,
            ending: ending.clone(),
        };
        return Ok(tokio::spawn(nav2.run()));
    }
    let drive = Drive {
        client: client.clone(),
        shared: shared.clone(),
        declared: declared.clone(),
        wheels: intake.wheels.subscribe(),
        seen: intake.seen.subscribe(),
        wishes,
        cmd_vel: bus.write(&topics.cmd_vel, Qos::Reliable)?,
        plans: plans.subscribe(),
        ending: ending.clone(),
    };
    let settings = settings.clone();
    Ok(tokio::spawn(async move { drive.run(&settings).await }))
}

fn control(Parts { settings, client, shared, plans, .. }: &Parts) -> Control {
    Control {
        client: client.clone(),
        shared: shared.clone(),
        plans: plans.clone(),
        services: settings.topics.services.clone(),
    }
}

fn sessions(parts: &Parts, bus: &Bus) -> Result<Sessions, Failure> {
    let Parts { declared, plans, ending, .. } = parts;
    let streaming = streaming(parts, bus)?;
    Ok(Sessions { streaming, plans: plans.clone(), declared: declared.clone(), ending: ending.clone() })
}

fn streaming(parts: &Parts, bus: &Bus) -> Result<Streaming, Failure> {
    let Parts { settings, client, shared, outbox, unanswered, .. } = parts;
    let pose = bus.write(&settings.topics.pose, Qos::Reliable)?;
    let path = bus.write(&settings.topics.path, Qos::Latest)?;
    let sureness = Sureness {
        new_place: bus.write(&settings.topics.new_place, Qos::Reliable)?,
        most_probable_place: bus.write(&settings.topics.most_probable_place, Qos::Reliable)?,
        matched: bus.write(&settings.topics.matched, Qos::Reliable)?,
    };
    let covariance = Covariance::planar(settings.position_sigma_m, settings.heading_sigma_rad);
    Ok(Streaming {
        client: client.clone(),
        shared: shared.clone(),
        outbox: outbox.clone(),
        telling: Telling::new(pose, path, settings.map_frame.clone(), covariance),
        sureness,
        words: settings.words,
        contents: ContentMaker::Images,
        unanswered: unanswered.clone(),
    })
}

fn markers(Parts { settings, client, shared, plans, .. }: &Parts, bus: &Bus) -> Result<Markers, Failure> {
    Ok(Markers {
        client: client.clone(),
        plans: plans.subscribe(),
        map_frame: settings.map_frame.clone(),
        shared: shared.clone(),
        out: bus.write(&settings.topics.markers, Qos::Latest)?,
    })
}

fn reporting(parts: &Parts, bus: Bus) -> Result<Reporting, Failure> {
    let Parts { settings, shared, outbox, unanswered, plans, .. } = parts;
    let plans = plans.subscribe();
    let diagnostics = bus.write(&settings.topics.diagnostics, Qos::Reliable)?;
    let (settings, shared, outbox) = (settings.clone(), shared.clone(), outbox.clone());
    Ok(Reporting { bus, settings, shared, outbox, unanswered: unanswered.clone(), plans, diagnostics })
}

/// Streams until a signal comes, and then until the last answers have.
async fn until_told(
    streaming: impl Future<Output = Result<(), SessionError>>,
    end: &watch::Sender<bool>,
    is_whole: impl Fn() -> bool,
) -> Result<(), Failure> {
    let mut interrupted = signal(SignalKind::interrupt())?;
    let mut terminated = signal(SignalKind::terminate())?;
    let mut looking = interval(DIAGNOSTICS_PERIOD);
    tokio::pin!(streaming);
    loop {
        tokio::select! {
            ended = &mut streaming => return Ok(ended?),
            _ = interrupted.recv() => break,
            _ = terminated.recv() => break,
            _ = looking.tick() => if !is_whole() { return Err(Failure::Died) },
        }
    }
    tracing::info!("ending, once what was taken is sent; a second signal ends at once");
    end.send_replace(true);
    tokio::select! {
        ended = streaming => Ok(ended?),
        _ = interrupted.recv() => Ok(()),
        _ = terminated.recv() => Ok(()),
    }
}

/// Tells of the bridge itself.
struct Reporting {
    bus: Bus,
    settings: Settings,
    shared: Shared,
    outbox: Arc<Outbox>,
    unanswered: Unanswered,
    plans: watch::Receiver<Plan>,
    diagnostics: Outgoing<DiagnosticArray>,
}

impl Reporting {
    async fn run(self) {
        let mut due = interval(DIAGNOSTICS_PERIOD);
        due.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut told = Vec::new();
        let began = Instant::now();
        let mut waits_for_images = true;
        loop {
            due.tick().await;
            if waits_for_images && began.elapsed() > IMAGES_PATIENCE {
                waits_for_images = false;
                self.tell_of_missing_images();
            }
            let mismatches = self.bus.mismatches();
            for mismatch in mismatches.iter().filter(|mismatch| !told.contains(*mismatch)) {
                tracing::error!("{mismatch}");
            }
            self.diagnostics.publish(self.report(&mismatches));
            told = mismatches;
        }
    }

    /// Nothing is wrong with a robot that is switched on later; a topic's name may be.
    fn tell_of_missing_images(&self) {
        if self.shared.lock().images.last.is_some() {
            return;
        }
        let topic = &self.settings.topics.image;
        let others = match self.bus.topics_of_images().join(", ") {
            others if others.is_empty() => "no images are published in this domain".to_owned(),
            others => format!("images are published on {others}: name one by image_topic"),
        };
        tracing::warn!("nothing has come on {topic} so far; {others}");
    }

    fn report(&self, mismatches: &[String]) -> DiagnosticArray {
        let unanswered = self.unanswered.lock().unwrap_or_else(PoisonError::into_inner).len();
        let plan = self.plans.borrow().clone();
        let state = self.shared.lock();
        let report = Report {
            state: &state,
            topics: &self.settings.topics,
            plan: &plan,
            robot: &self.settings.namespace,
            mismatches,
            waiting: self.outbox.len(),
            unanswered,
        };
        report.message()
    }
}
