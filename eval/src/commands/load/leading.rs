//! Robots that are led along one map: how long they wait for commands.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, timeout};
use waypost_client::{
    Client, FrameInput, Navigation, NavigationEvent, NavigationOptions, Reading, SessionOptions, v1,
};

use super::contents::Contents;
use super::report::LatencyReport;
use super::robot::stream_all;
use super::server::{MAP, ServerOptions, ServerUnderLoad, breach};
use super::{positive, seconds};

/// From image to image.
const FRAME_PERIOD: Duration = Duration::from_millis(500);

/// Longest that a command is waited for: the last one holds for so long.
const PATIENCE: Duration = Duration::from_millis(500);

/// What commands may take, in milliseconds: half of them, and 99 of 100.
const TARGET_MS: [f64; 2] = [2.0, 20.0];

/// Robots that are led along one map: how long they wait for commands.
#[derive(Args)]
pub(super) struct LeadingOptions {
    /// Folder of JPEG or PNG images, which the map is made of and the robots see.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Robots.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=200))]
    robots: u32,
    /// Wheel reports a second of each.
    #[arg(long, value_name = "HZ", default_value_t = 25.0, value_parser = positive)]
    rate_hz: f64,
    /// How long.
    #[arg(long = "seconds", value_name = "S", default_value = "20", value_parser = seconds)]
    duration: Duration,
}

/// How long robots waited for their commands.
#[derive(Serialize)]
pub(crate) struct LeadingReport {
    pub robots: u32,
    pub rate_hz: f64,
    pub seconds: f64,
    /// Wheel reports that were sent.
    pub reports: u64,
    /// Those of them that no command came of within half a second.
    pub unanswered: u64,
    /// From a report to its command.
    pub command: LatencyReport,
    /// Frames that were looked at.
    pub frames: u64,
    /// Those that recognised a place.
    pub recognised: u64,
    /// Whether half of the commands take at most 2 ms, and 99 of 100 at most 20 ms.
    pub target_met: bool,
}

/// What one robot has met.
#[derive(Debug, Default)]
struct Met {
    commands: Vec<Duration>,
    unanswered: u64,
    frames: u64,
    recognised: u64,
}

pub(super) async fn run(server: &ServerOptions, options: &LeadingOptions) -> Result<LeadingReport> {
    let LeadingOptions { images, robots, rate_hz, duration } = options;
    let contents = Arc::new(Contents::images(images)?);
    let server = ServerUnderLoad::start(server).await?;
    let client = Client::connect(&server.endpoint()).await?;
    make_map(&client, &contents).await?;
    let mut led = JoinSet::new();
    for number in 0..*robots {
        let options = NavigationOptions {
            navigation_id: format!("robot-{number}"),
            goal: Some(v1::Goal { target: Some(v1::goal::Target::PlaceNumber(0)) }),
            ..NavigationOptions::new(MAP, camera())
        };
        let navigation = client.navigate(options).await?;
        led.spawn(lead(navigation, contents.clone(), number, (*rate_hz, *duration)));
    }
    let met = led.join_all().await.into_iter().collect::<Result<Vec<Met>>>()?;
    server.stop()?;
    let sum = |of: fn(&Met) -> u64| met.iter().map(of).sum();
    let command = LatencyReport::of(met.iter().flat_map(|met| met.commands.iter().copied()));
    Ok(LeadingReport {
        robots: *robots,
        rate_hz: *rate_hz,
        seconds: duration.as_secs_f64(),
        reports: sum(|met| met.commands.len() as u64 + met.unanswered),
        unanswered: sum(|met| met.unanswered),
        frames: sum(|met| met.frames),
        recognised: sum(|met| met.recognised),
        target_met: command.is_within(TARGET_MS),
        command,
    })
}

/// Every image is of a place half a metre on.
async fn make_map(client: &Client, contents: &Arc<Contents>) -> Result<()> {
    let options = SessionOptions { camera: Some(camera()), ..SessionOptions::new(MAP) };
    let contents = contents.clone();
    let frames = (0..contents.frames.len()).map(move |index| {
        let sequence = index as u64 + 1;
        let stamp_ns = 1_000_000_000 * sequence as i64;
        let odometry = Some(at(0.5 * sequence as f64));
        FrameInput {
            sequence,
            stamp_ns,
            content: contents.frames[index].clone(),
            odometry,
            note: String::new(),
        }
    });
    stream_all(client, options, frames, || {}).await
}

/// Reports what standing wheels say, and sends an image twice a second.
async fn lead(
    mut navigation: Navigation,
    contents: Arc<Contents>,
    number: u32,
    (rate_hz, duration): (f64, Duration),
) -> Result<Met> {
    let mut reports = interval(Duration::from_secs_f64(1.0 / rate_hz));
    reports.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut guidance = navigation.guidance();
    let began = Instant::now();
    let mut met = Met::default();
    let mut frame_due = Duration::ZERO;
    let mut sequence = 0;
    while began.elapsed() < duration {
        reports.tick().await;
        let now = began.elapsed();
        let stamp_ns = i64::try_from(now.as_nanos()).unwrap_or(i64::MAX);
        if now >= frame_due {
            frame_due += FRAME_PERIOD;
            sequence += 1;
            let image = (sequence as usize + 7 * number as usize) % contents.frames.len();
            let content = contents.frames[image].clone();
            navigation.see(FrameInput {
                sequence,
                stamp_ns,
                content,
                odometry: Some(at(0.0)),
                note: String::new(),
            });
        }
        let sent = Instant::now();
        navigation.report(Reading { stamp_ns, odometry: at(0.0), reflex: false });
        let answered = timeout(PATIENCE, guidance.wait_for(|told| is_answer(told.as_ref(), stamp_ns))).await;
        match answered {
            Ok(Ok(_)) => met.commands.push(sent.elapsed()),
            Ok(Err(_)) | Err(_) => met.unanswered += 1,
        }
        while let Some(event) = navigation.try_next() {
            match event {
                NavigationEvent::Seen(seen) => {
                    met.frames += 1;
                    met.recognised += u64::from(seen.place_number.is_some());
                }
                NavigationEvent::FrameRefused(_)
                | NavigationEvent::WheelsRefused(_)
                | NavigationEvent::Disconnected { .. } => {
                    return Err(breach("a robot was refused what it may ask"));
                }
                // A robot that sees places all over the map may find itself beyond its goal.
                NavigationEvent::GoalRefused(_) | NavigationEvent::Reconnected { .. } => {}
            }
        }
    }
    Ok(met)
}

fn is_answer(told: Option<&v1::Guidance>, stamp_ns: i64) -> bool {
    told.is_some_and(|told| told.stamp_ns == stamp_ns)
}

fn at(x: f64) -> v1::Odometry {
    v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        }),
        covariance: Vec::new(),
    }
}

fn camera() -> v1::Camera {
    let field_of_view = v1::FieldOfView { horizontal_rad: 1.1 };
    v1::Camera { model: Some(v1::camera::Model::FieldOfView(field_of_view)), ..v1::Camera::default() }
}
