//! `waypost-eval load`: a real server in a process of its own, and robots that drive it over gRPC.

pub(super) mod contents;
mod growth;
mod leading;
mod overload;
pub(super) mod panoramas;
mod report;
mod robot;
mod robots;
pub(super) mod server;
mod stalled;
mod words;

use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use serde::Serialize;

use crate::choices::number;
use server::ServerOptions;

/// Put a real server under load: it is started on a temporary directory, driven over gRPC, and stopped.
#[derive(Args)]
pub(crate) struct LoadOptions {
    #[command(subcommand)]
    scenario: Scenario,
    #[command(flatten)]
    server: ServerOptions,
}

#[derive(Subcommand)]
enum Scenario {
    Words(words::WordsOptions),
    Overload(overload::OverloadOptions),
    Growth(growth::GrowthOptions),
    Leading(leading::LeadingOptions),
    Panoramas(panoramas::PanoramasOptions),
    Robots(robots::RobotsOptions),
}

/// What came out.
#[derive(Serialize)]
#[serde(tag = "scenario", rename_all = "lowercase")]
pub(crate) enum LoadReport {
    Words(words::WordsReport),
    Overload(Box<overload::OverloadReport>),
    Growth(growth::GrowthReport),
    Leading(leading::LeadingReport),
    Panoramas(panoramas::PanoramasReport),
    Robots(robots::RobotsReport),
}

/// Starts the server, drives robots as the scenario says, and says how long they waited.
pub(crate) fn run(options: &LoadOptions) -> Result<LoadReport> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    runtime
        .context("no threads can be started; end other programs")?
        .block_on(drive(&options.server, &options.scenario))
}

async fn drive(server: &ServerOptions, scenario: &Scenario) -> Result<LoadReport> {
    Ok(match scenario {
        Scenario::Words(options) => LoadReport::Words(words::run(server, options).await?),
        Scenario::Overload(options) => LoadReport::Overload(Box::new(overload::run(server, options).await?)),
        Scenario::Growth(options) => LoadReport::Growth(growth::run(server, options).await?),
        Scenario::Leading(options) => LoadReport::Leading(leading::run(server, options).await?),
        Scenario::Panoramas(options) => LoadReport::Panoramas(panoramas::run(server, options).await?),
        Scenario::Robots(options) => LoadReport::Robots(robots::run(server, options).await?),
    })
}

/// Reads a rate or a factor.
fn positive(text: &str) -> Result<f64, String> {
    number(0.1..=3600.0)(text)
}

/// Reads a duration in seconds.
fn seconds(text: &str) -> Result<Duration, String> {
    positive(text).map(Duration::from_secs_f64)
}
