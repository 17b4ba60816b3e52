//! Many word streams into one map.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use tokio::time::Instant;

use super::contents::{Contents, WordSource};
use super::report::{LatencyReport, ServerUse};
use super::robot::{Answered, AtTheEnd, Camera, Record, Robot, drive_all};
use super::server::{ServerOptions, ServerUnderLoad};
use super::{positive, seconds};

/// What beyond computing may take, in milliseconds: half of the frames, and 99 of 100.
const TARGET_MS: [f64; 2] = [5.0, 20.0];

/// All streams are open by then.
pub(super) const LEAD: Duration = Duration::from_millis(200);

/// Many word streams into one map: what a frame takes beyond computing.
#[derive(Args)]
pub(super) struct WordsOptions {
    #[command(flatten)]
    source: WordSource,
    /// Robots.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
    streams: u32,
    /// Frames a second of each robot.
    #[arg(long, value_name = "HZ", default_value_t = 2.0, value_parser = positive)]
    rate_hz: f64,
    /// How long.
    #[arg(long = "seconds", value_name = "S", default_value = "60", value_parser = seconds)]
    duration: Duration,
}

/// What the robots saw of the server.
#[derive(Serialize)]
pub(crate) struct WordsReport {
    pub streams: u32,
    pub rate_hz: f64,
    pub seconds: f64,
    /// Mean size of a frame's words on the wire.
    pub bytes_per_frame: f64,
    /// Frames that robots took.
    pub offered: u64,
    /// Frames that were answered.
    pub answered: usize,
    /// Refusals, for now or for good.
    pub refusals: u64,
    /// Round trip less what the server spent on the frame itself.
    pub beyond_computing: LatencyReport,
    /// From when the frame was due to its answer.
    pub round_trip: LatencyReport,
    /// What the server spent on the frame itself.
    pub computing: LatencyReport,
    /// How late robots were with sending: the load generator's own share, within the round trip.
    pub send_late: LatencyReport,
    /// Frames that share a commit, on average; null if the server does not log it.
    pub frames_per_commit: Option<f64>,
    /// What the server took meanwhile.
    pub server: ServerUse,
    /// Whether half of the frames take at most 5 ms beyond computing, and 99 of 100 at most 20 ms.
    pub target_met: bool,
}

pub(super) async fn run(server: &ServerOptions, options: &WordsOptions) -> Result<WordsReport> {
    let WordsOptions { source, streams, rate_hz, duration } = options;
    let contents = Arc::new(Contents::words(&server.model, source)?);
    let server = ServerUnderLoad::start(server).await?;
    let fleet = Fleet { prefix: "robot", robots: *streams, rate_hz: *rate_hz, duration: *duration };
    let robots = fleet.open(&server.endpoint(), &contents).await?;
    let began = Instant::now();
    let cpu_s = server.cpu_s()?;
    let record = fleet.drive(robots).await?;
    let cpu_cores = (server.cpu_s()? - cpu_s) / began.elapsed().as_secs_f64();
    let server_use = ServerUse { cpu_cores, rss_mib: server.rss_mib()? };
    let frames_per_commit = server.commits().frames_per_commit();
    server.stop()?;

    let latency = |of: fn(&Answered) -> Duration| LatencyReport::of(record.answered.iter().map(of));
    let beyond_computing = latency(Answered::beyond_computing);
    Ok(WordsReport {
        streams: *streams,
        rate_hz: *rate_hz,
        seconds: duration.as_secs_f64(),
        bytes_per_frame: contents.bytes_per_frame(),
        offered: record.offered,
        answered: record.answered.len(),
        refusals: record.refused_for_now + record.refused,
        round_trip: latency(|answered| answered.round_trip),
        computing: latency(|answered| answered.computing),
        send_late: latency(|answered| answered.send_late),
        frames_per_commit,
        server: server_use,
        target_met: beyond_computing.is_within(TARGET_MS),
        beyond_computing,
    })
}

/// Robots with one frame rate, each out of step with the others.
pub(super) struct Fleet {
    pub(super) prefix: &'static str,
    pub(super) robots: u32,
    pub(super) rate_hz: f64,
    pub(super) duration: Duration,
}

impl Fleet {
    pub(super) async fn open(&self, endpoint: &str, contents: &Arc<Contents>) -> Result<Vec<Robot>> {
        let mut opened = Vec::new();
        for robot in 0..self.robots {
            // Spread over what there is to see.
            let first_content = contents.frames.len() * robot as usize / self.robots as usize;
            let session = format!("{}-{robot}", self.prefix);
            opened.push(Robot::open(endpoint, &session, contents.clone(), first_content).await?);
        }
        Ok(opened)
    }

    /// Every frame is sent at its time, whatever became of those before, and all are waited for.
    pub(super) async fn drive(&self, robots: Vec<Robot>) -> Result<Record> {
        let interval = Duration::from_secs_f64(1.0 / self.rate_hz);
        let start = Instant::now() + LEAD;
        // Clocks of robots are not in step; the seed makes runs alike.
        let mut phase = ChaCha8Rng::seed_from_u64(1);
        let cameras = robots.into_iter().map(|robot| {
            let first = start + interval.mul_f64(phase.random_range(0.0..1.0));
            let until = start + self.duration;
            let at_the_end = AtTheEnd::Wait;
            (robot, Camera { first, interval, until, backlog_frames: usize::MAX, at_the_end })
        });
        Ok(Record::together(drive_all(cameras).await?))
    }
}
