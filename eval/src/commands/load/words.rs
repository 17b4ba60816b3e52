//! Many word streams into one map, or into several.

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
use super::server::{ServerOptions, ServerUnderLoad, map_name};
use super::{positive, seconds};
use crate::error::refused;

/// What beyond computing may take, in milliseconds: half of the frames, and 99 of 100.
const TARGET_MS: [f64; 2] = [5.0, 20.0];

/// All streams are open by then.
pub(super) const LEAD: Duration = Duration::from_millis(200);

/// Many word streams into one map, or several: what a frame takes beyond computing.
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
    /// Servers over one database, over which robots are spread; the first one owns the database.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    servers: u32,
    /// Maps over which robots are spread.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    maps: u32,
}

/// What the robots saw of the server.
#[derive(Serialize)]
pub(crate) struct WordsReport {
    pub streams: u32,
    pub maps: u32,
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
    /// Frames of a map that share a commit, on average; null if the server does not log it.
    pub frames_per_commit: Option<f64>,
    /// What the server took meanwhile; of several, the one that owns the database.
    pub server: ServerUse,
    /// What each of the others took.
    pub others: Vec<ServerUse>,
    /// Processor time of all servers, for each answered frame.
    pub cpu_ms_per_frame: f64,
    /// Whether half of the frames take at most 5 ms beyond computing, and 99 of 100 at most 20 ms.
    pub target_met: bool,
}

pub(super) async fn run(server: &ServerOptions, options: &WordsOptions) -> Result<WordsReport> {
    let WordsOptions { source, streams, rate_hz, duration, servers, maps } = options;
    let contents = Arc::new(Contents::words(&server.model, source)?);
    if *servers > 1 && server.storage.is_none() {
        return Err(refused("several servers need a database that they can share; give --storage"));
    }
    let owner = ServerUnderLoad::start(server).await?;
    owner.make_maps(*maps).await?;
    let mut all = vec![owner];
    for number in 1..*servers {
        all.push(all[0].another(server, number).await?);
    }
    let endpoints: Vec<String> = all.iter().map(ServerUnderLoad::endpoint).collect();
    let fleet =
        Fleet { prefix: "robot", robots: *streams, maps: *maps, rate_hz: *rate_hz, duration: *duration };
    let robots = fleet.open(&endpoints, &contents).await?;
    let began = Instant::now();
    let cpu_before_s = all.iter().map(ServerUnderLoad::cpu_s).collect::<Result<Vec<f64>>>()?;
    let record = fleet.drive(robots).await?;
    let elapsed_s = began.elapsed().as_secs_f64();
    let used = |(server, before_s): (&ServerUnderLoad, &f64)| {
        let cpu_cores = (server.cpu_s()? - before_s) / elapsed_s;
        Ok(ServerUse { cpu_cores, rss_mib: server.rss_mib()? })
    };
    let mut uses = all.iter().zip(&cpu_before_s).map(used).collect::<Result<Vec<ServerUse>>>()?;
    let frames_per_commit = all[0].commits().frames_per_commit();
    // The owner last: nobody is to take its place.
    for server in all.into_iter().rev() {
        server.stop()?;
    }
    let cpu_cores: f64 = uses.iter().map(|server| server.cpu_cores).sum();
    let others = uses.split_off(1);
    let server = uses[0];

    let latency = |of: fn(&Answered) -> Duration| LatencyReport::of(record.answered.iter().map(of));
    let beyond_computing = latency(Answered::beyond_computing);
    Ok(WordsReport {
        streams: *streams,
        maps: *maps,
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
        server,
        others,
        cpu_ms_per_frame: 1e3 * cpu_cores * elapsed_s / record.answered.len().max(1) as f64,
        target_met: beyond_computing.is_within(TARGET_MS),
        beyond_computing,
    })
}

/// Robots with one frame rate, each out of step with the others.
pub(super) struct Fleet {
    pub(super) prefix: &'static str,
    pub(super) robots: u32,
    /// Over which they are spread.
    pub(super) maps: u32,
    pub(super) rate_hz: f64,
    pub(super) duration: Duration,
}

impl Fleet {
    pub(super) async fn open(&self, endpoints: &[String], contents: &Arc<Contents>) -> Result<Vec<Robot>> {
        let mut opened = Vec::new();
        for robot in 0..self.robots {
            // Spread over what there is to see.
            let first_content = contents.frames.len() * robot as usize / self.robots as usize;
            let session = format!("{}-{robot}", self.prefix);
            let endpoint = &endpoints[robot as usize % endpoints.len()];
            let map = map_name(robot % self.maps);
            opened.push(Robot::open(endpoint, (&map, &session), contents.clone(), first_content).await?);
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
