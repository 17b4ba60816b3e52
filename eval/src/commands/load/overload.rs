//! More images than the server can work off.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::contents::Contents;
use super::report::{LatencyReport, ServerUse};
use super::robot::{AtTheEnd, Camera, Record, Robot, drive_all};
use super::server::{MAP, ServerOptions, ServerUnderLoad, cpu_s_of};
use super::words::LEAD;
use super::{positive, seconds};
use crate::timing::median;

/// Images a second of each robot.
const CAMERA_HZ: f64 = 2.0;

/// Frames without an answer that a robot keeps; beyond that it drops new ones.
const BACKLOG_FRAMES: usize = 8;

/// Robots that keep the server busy without overloading it.
const PEAK_ROBOTS: u32 = 8;
const PEAK_DURATION: Duration = Duration::from_secs(10);

/// Frames sent one by one, each after the answer to the last.
const SINGLE_DURATION: Duration = Duration::from_secs(5);

/// How long is waited for the server to be as fast as before.
const RECOVERY_PATIENCE: Duration = Duration::from_secs(20);

const TARGET_OF_PEAK: f64 = 0.8;
const TARGET_RECOVERY_S: f64 = 5.0;
/// The median of the second half of the time may be this many times that of the first: maps do grow.
const TARGET_MEMORY: f64 = 1.2;

/// More images than the server can work off: goodput, memory, recovery.
#[derive(Args)]
pub(super) struct OverloadOptions {
    /// Folder of JPEG or PNG images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// How long.
    #[arg(long = "seconds", value_name = "S", default_value = "60", value_parser = seconds)]
    duration: Duration,
    /// How many times the peak goodput is offered.
    #[arg(long, value_name = "TIMES", default_value_t = 5.0, value_parser = positive)]
    factor: f64,
}

/// How the server bore it.
#[derive(Serialize)]
pub(crate) struct OverloadReport {
    pub factor: f64,
    pub seconds: f64,
    /// Robots, each with a camera of 2 Hz and a backlog of 8 frames.
    pub robots: u32,
    /// Frames answered per second at the most, when each robot sends as fast as it is answered.
    pub peak_goodput_hz: f64,
    /// Images that cameras took per second.
    pub offered_hz: f64,
    /// Frames answered per second under overload.
    pub goodput_hz: f64,
    /// The same, as a share of the peak.
    pub goodput_of_peak: f64,
    /// Frames answered in each second.
    pub answered_per_second: Vec<u64>,
    /// Frames answered to the robot that got fewest, to the median one, and to the one that got most.
    pub answered_per_robot: [u64; 3],
    /// Images that robots dropped because their backlog was full.
    pub dropped: u64,
    /// Refusals of frames that robots then sent again.
    pub refused_for_now: u64,
    /// Those of them with RetryInfo; the others followed a refused frame and wait for it.
    pub with_retry_info: u64,
    /// Refusals for good.
    pub refused: u64,
    /// Frames sent for each that was answered.
    pub sent_per_answer: f64,
    /// From the taking of an image to its answer, of those answered.
    pub round_trip: LatencyReport,
    /// What the server took under overload.
    pub server: ServerUse,
    /// Cores that the robots took from it on this machine, on average.
    pub robots_cpu_cores: f64,
    /// The server's memory in each second, in MiB.
    pub rss_mib: Vec<f64>,
    /// Round trip of a single frame before.
    pub single_before: LatencyReport,
    /// From the end of the overload to the first answer that took no longer than the slowest single frame
    /// before; null if there was none for 20 s.
    pub recovery_s: Option<f64>,
    /// At least 80 % of peak goodput.
    pub goodput_target_met: bool,
    /// In the median, at most 20 % more memory in the second half than in the first.
    pub memory_target_met: bool,
    /// Within 5 s.
    pub recovery_target_met: bool,
}

pub(super) async fn run(server: &ServerOptions, options: &OverloadOptions) -> Result<OverloadReport> {
    let OverloadOptions { images, duration, factor } = options;
    let contents = Arc::new(Contents::images(images)?);
    let server = ServerUnderLoad::start(server).await?;
    let load = Load { server: &server, contents };
    let before = load.single_frames("before", SINGLE_DURATION).await?;
    let single_before = LatencyReport::of(before.answered.iter().map(|answered| answered.round_trip));
    let peak_goodput_hz = load.peak_goodput_hz().await?;

    let robots = (factor * peak_goodput_hz / CAMERA_HZ).ceil() as u32;
    let Overloaded { start, records, cpu_cores, robots_cpu_cores, rss_mib } =
        load.overload(robots, *duration).await?;
    let ended = Instant::now();
    let usual = before.answered.iter().map(|answered| answered.round_trip).max().unwrap_or_default();
    let after = load.single_frames("after", RECOVERY_PATIENCE).await?;
    let recovered = after.answered.iter().find(|answered| answered.round_trip <= usual);
    let recovery_s = recovered.map(|answered| (answered.at - ended).as_secs_f64());
    server.stop()?;

    let mut per_robot: Vec<u64> = records.iter().map(|record| record.answered.len() as u64).collect();
    per_robot.sort_unstable();
    let place = |index: usize| per_robot.get(index).copied().unwrap_or_default();
    let record = Record::together(records);
    let answered = record.answered.len() as f64;
    let goodput_hz = answered / duration.as_secs_f64();
    let (first_half, second_half) = rss_mib.split_at(rss_mib.len() / 2);
    Ok(OverloadReport {
        factor: *factor,
        seconds: duration.as_secs_f64(),
        robots,
        peak_goodput_hz,
        offered_hz: record.offered as f64 / duration.as_secs_f64(),
        goodput_hz,
        goodput_of_peak: goodput_hz / peak_goodput_hz,
        answered_per_second: per_second(&record, start, *duration),
        answered_per_robot: [place(0), place(per_robot.len() / 2), place(per_robot.len().saturating_sub(1))],
        dropped: record.dropped,
        refused_for_now: record.refused_for_now,
        with_retry_info: record.with_retry_info,
        refused: record.refused,
        sent_per_answer: record.sent as f64 / answered,
        round_trip: LatencyReport::of(record.answered.iter().map(|answered| answered.round_trip)),
        server: ServerUse { cpu_cores, rss_mib: rss_mib.last().copied().unwrap_or_default() },
        robots_cpu_cores,
        single_before,
        recovery_s,
        goodput_target_met: goodput_hz >= TARGET_OF_PEAK * peak_goodput_hz,
        memory_target_met: median(second_half.to_vec())
            <= median(first_half.to_vec()).map(|mib| TARGET_MEMORY * mib),
        recovery_target_met: recovery_s.is_some_and(|recovery_s| recovery_s <= TARGET_RECOVERY_S),
        rss_mib,
    })
}

struct Load<'a> {
    server: &'a ServerUnderLoad,
    contents: Arc<Contents>,
}

struct Overloaded {
    start: Instant,
    records: Vec<Record>,
    cpu_cores: f64,
    robots_cpu_cores: f64,
    rss_mib: Vec<f64>,
}

impl Load<'_> {
    /// One robot that sends its next frame when the last is answered.
    async fn single_frames(&self, session: &str, duration: Duration) -> Result<Record> {
        let robot = self.robot(session, 0).await?;
        robot.drive(as_fast_as_answered(1, Instant::now(), duration)).await
    }

    /// Robots that are answered as fast as the server can, with none refused.
    async fn peak_goodput_hz(&self) -> Result<f64> {
        let robots = self.robots("peak", PEAK_ROBOTS).await?;
        let start = Instant::now() + LEAD;
        let camera = as_fast_as_answered(BACKLOG_FRAMES, start, PEAK_DURATION);
        let records = drive_all(robots.into_iter().map(|robot| (robot, camera))).await?;
        Ok(Record::together(records).answered.len() as f64 / PEAK_DURATION.as_secs_f64())
    }

    async fn overload(&self, count: u32, duration: Duration) -> Result<Overloaded> {
        let robots = self.robots("overload", count).await?;
        let start = Instant::now() + LEAD;
        let interval = Duration::from_secs_f64(1.0 / CAMERA_HZ);
        let cameras = (0..count).zip(robots).map(|(index, robot)| {
            // Cameras take turns.
            let first = start + interval * index / count;
            let until = start + duration;
            let at_the_end = AtTheEnd::Leave;
            (robot, Camera { first, interval, until, backlog_frames: BACKLOG_FRAMES, at_the_end })
        });
        let cpu_s = self.server.cpu_s()?;
        let own_cpu_s = cpu_s_of("self")?;
        let mut rss_mib = Vec::new();
        let records = tokio::select! {
            records = drive_all(cameras) => records?,
            failed = self.watch_memory(&mut rss_mib) => return Err(failed),
        };
        let elapsed_s = start.elapsed().as_secs_f64();
        let cpu_cores = (self.server.cpu_s()? - cpu_s) / elapsed_s;
        let robots_cpu_cores = (cpu_s_of("self")? - own_cpu_s) / elapsed_s;
        Ok(Overloaded { start, records, cpu_cores, robots_cpu_cores, rss_mib })
    }

    /// Never ends well.
    async fn watch_memory(&self, rss_mib: &mut Vec<f64>) -> anyhow::Error {
        let mut every_second = interval(Duration::from_secs(1));
        every_second.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            every_second.tick().await;
            match self.server.rss_mib() {
                Ok(mib) => rss_mib.push(mib),
                Err(error) => return error,
            }
        }
    }

    async fn robots(&self, prefix: &str, count: u32) -> Result<Vec<Robot>> {
        let mut robots = Vec::new();
        for index in 0..count {
            let first_content = self.contents.frames.len() * index as usize / count as usize;
            robots.push(self.robot(&format!("{prefix}-{index}"), first_content).await?);
        }
        Ok(robots)
    }

    async fn robot(&self, session: &str, first_content: usize) -> Result<Robot> {
        Robot::open(&self.server.endpoint(), (MAP, session), self.contents.clone(), first_content).await
    }
}

/// A robot that takes its next image when there is room for it.
fn as_fast_as_answered(backlog_frames: usize, first: Instant, duration: Duration) -> Camera {
    let until = first + duration;
    Camera { first, interval: Duration::ZERO, until, backlog_frames, at_the_end: AtTheEnd::Leave }
}

/// Answers in each second from `start` on.
fn per_second(record: &Record, start: Instant, duration: Duration) -> Vec<u64> {
    let mut counts = vec![0; duration.as_secs_f64().ceil() as usize];
    for answered in &record.answered {
        let second = answered.at.saturating_duration_since(start).as_secs() as usize;
        if let Some(count) = counts.get_mut(second) {
            *count += 1;
        }
    }
    counts
}
