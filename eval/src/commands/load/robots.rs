//! Four robots in one map, without and with clients that do not read.

use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;

use super::contents::Contents;
use super::report::LatencyReport;
use super::robot::Record;
use super::server::ServerUnderLoad;
use super::stalled::{StalledConnection, StalledStream};
use super::words::Fleet;
use super::{ServerOptions, WordSource};
use crate::error::EvalError;

const ROBOTS: u32 = 4;

/// What the four robots send, and for how long.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotsOptions {
    /// Where the words come from.
    pub source: WordSource,
    /// Frames a second of each robot.
    pub rate_hz: f64,
    /// How long, alone and then again beside the stalled ones.
    pub duration: Duration,
}

/// How long the four waited for their answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotsReport {
    /// Name of the scenario.
    pub scenario: &'static str,
    /// See [`RobotsOptions::rate_hz`].
    pub rate_hz: f64,
    /// See [`RobotsOptions::duration`].
    pub seconds: f64,
    /// The four by themselves.
    pub alone: RobotsFigures,
    /// The four beside a stream that is never read, and a connection that is never read.
    pub beside_stalled: RobotsFigures,
}

/// Figures of four robots together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RobotsFigures {
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

pub(super) async fn run(server: &ServerOptions, options: &RobotsOptions) -> Result<RobotsReport, EvalError> {
    let RobotsOptions { source, rate_hz, duration } = options;
    let contents = Arc::new(Contents::words(&server.model, source)?);
    let server = ServerUnderLoad::start(server).await?;
    let fleet = |prefix| Fleet { prefix, robots: ROBOTS, rate_hz: *rate_hz, duration: *duration };
    let measure = async |fleet: Fleet| {
        let robots = fleet.open(&server.endpoint(), &contents).await?;
        let record = fleet.drive(robots).await?;
        Ok::<_, EvalError>(figures(&record, server.rss_mib()?))
    };
    let alone = measure(fleet("alone")).await?;
    let unread = StalledStream::open(&server.endpoint(), "stalled-stream", &contents, *rate_hz).await?;
    let deaf = StalledConnection::open(&server.address, "stalled-connection", &contents, *rate_hz).await?;
    let beside_stalled = measure(fleet("beside")).await?;
    drop((unread, deaf));
    server.stop().await?;
    let seconds = duration.as_secs_f64();
    Ok(RobotsReport { scenario: "robots", rate_hz: *rate_hz, seconds, alone, beside_stalled })
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

impl RobotsReport {
    pub(super) fn table(&self) -> String {
        let Self { scenario: _, rate_hz, seconds, alone, beside_stalled } = self;
        let rows = [("alone", alone), ("beside stalled", beside_stalled)].map(|(name, figures)| {
            let RobotsFigures { offered, answered, round_trip, beyond_computing, server_rss_mib } = figures;
            format!(
                "{name}\n  frames            {answered} answered of {offered}\n  round trip        {}\n  beyond computing  {}\n  \
                 memory            {server_rss_mib:.0} MiB\n",
                round_trip.text(),
                beyond_computing.text(),
            )
        });
        format!("{ROBOTS} robots at {rate_hz} Hz for {seconds} s\n{}", rows.concat())
    }
}
