//! Four robots in one map, without and with clients that do not read.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde::Serialize;

use super::contents::{Contents, WordSource};
use super::report::LatencyReport;
use super::robot::Record;
use super::server::{ServerOptions, ServerUnderLoad};
use super::stalled::{StalledConnection, StalledStream};
use super::words::Fleet;
use super::{positive, seconds};

const ROBOTS: u32 = 4;

/// Four robots in one map, alone and beside clients that do not read their answers.
#[derive(Args)]
pub(super) struct RobotsOptions {
    #[command(flatten)]
    source: WordSource,
    /// Frames a second of each robot.
    #[arg(long, value_name = "HZ", default_value_t = 5.0, value_parser = positive)]
    rate_hz: f64,
    /// How long, alone and then again beside the stalled ones.
    #[arg(long = "seconds", value_name = "S", default_value = "20", value_parser = seconds)]
    duration: Duration,
}

/// How long the four waited for their answers.
#[derive(Serialize)]
pub(crate) struct RobotsReport {
    pub rate_hz: f64,
    pub seconds: f64,
    /// The four by themselves.
    pub alone: RobotsFigures,
    /// The four beside a stream that is never read, and a connection that is never read.
    pub beside_stalled: RobotsFigures,
}

/// Figures of four robots together.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct RobotsFigures {
    /// Frames that they took.
    pub offered: u64,
    /// Frames that were answered.
    pub answered: usize,
    /// From when the frame was due to its answer.
    pub round_trip: LatencyReport,
    /// Round trip less what the server spent on the frame itself.
    pub beyond_computing: LatencyReport,
    /// The server's memory at the end, in MiB.
    pub server_rss_mib: f64,
}

pub(super) async fn run(server: &ServerOptions, options: &RobotsOptions) -> Result<RobotsReport> {
    let RobotsOptions { source, rate_hz, duration } = options;
    let contents = Arc::new(Contents::words(&server.model, source)?);
    let server = ServerUnderLoad::start(server).await?;
    let fleet = |prefix| Fleet { prefix, robots: ROBOTS, maps: 1, rate_hz: *rate_hz, duration: *duration };
    let measure = async |fleet: Fleet| {
        let robots = fleet.open(&[server.endpoint()], &contents).await?;
        let record = fleet.drive(robots).await?;
        Ok::<_, anyhow::Error>(figures(&record, server.rss_mib()?))
    };
    let alone = measure(fleet("alone")).await?;
    let unread = StalledStream::open(&server.endpoint(), "stalled-stream", &contents, *rate_hz).await?;
    let deaf = StalledConnection::open(&server.address(), "stalled-connection", &contents, *rate_hz).await?;
    let beside_stalled = measure(fleet("beside")).await?;
    drop((unread, deaf));
    server.stop()?;
    let seconds = duration.as_secs_f64();
    Ok(RobotsReport { rate_hz: *rate_hz, seconds, alone, beside_stalled })
}

fn figures(record: &Record, server_rss_mib: f64) -> RobotsFigures {
    RobotsFigures {
        offered: record.offered,
        answered: record.answered.len(),
        round_trip: LatencyReport::of(record.answered.iter().map(|answered| answered.round_trip)),
        beyond_computing: LatencyReport::of(
            record.answered.iter().map(super::robot::Answered::beyond_computing),
        ),
        server_rss_mib,
    }
}
