//! Joins a ROS 2 robot to a Waypost server, over DDS and without ROS.

use std::io::{IsTerminal, Write};
use std::process::ExitCode;

use clap::Parser;
use tracing_subscriber::EnvFilter;

use failure::Failure;
use given::Given;

mod asks;
mod bridge;
mod bus;
mod calls;
mod camera;
mod control;
mod diagnostics;
mod drive;
mod failure;
mod gate;
mod given;
mod graph;
mod intake;
mod markers;
mod names;
mod nav2;
mod outbox;
mod peers;
mod plan;
mod raw;
mod robot_words;
mod session;
mod sessions;
mod settings;
mod shown;
mod state;
mod telling;
mod tf;
mod viewers;

/// RustDDS tells of what is everyday in a network, even at its end; `RUST_LOG=rustdds=warn` shows it.
const DEFAULT_LOG: &str = "warn,waypost_ros=info,rustdds=off";

fn main() -> ExitCode {
    let given = Given::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_unset| EnvFilter::new(DEFAULT_LOG));
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        // Where nobody reads it any more, saying so would panic.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .with_env_filter(filter)
        .with_target(false)
        .init();
    match run(given) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // If stderr is closed, the message is lost.
            let _ = writeln!(std::io::stderr(), "waypost-ros: {failure}");
            failure.exit_code()
        }
    }
}

fn run(given: Given) -> Result<(), Failure> {
    let settings = given.settings()?;
    let runtime = tokio::runtime::Runtime::new()?;
    let ended = runtime.block_on(bridge::run(settings));
    // Does not wait for threads that still decode.
    runtime.shutdown_background();
    ended
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Given::command().debug_assert();
    }
}
