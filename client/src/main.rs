//! The `waypost` command line: models, maps and streams of a Waypost server.

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use commands::{demo, job, map, model, stream};
use failure::{EXIT_CODES, Failure};
use output::Output;

mod commands;
mod failure;
mod images;
mod odometry;
mod output;
mod progress;
mod replay;
mod server_process;
mod truth;
mod views;

/// Place recognition and maps from a robot's images, kept by a Waypost server.
#[derive(Parser)]
#[command(name = "waypost", version, after_help = EXIT_CODES)]
struct Arguments {
    #[command(flatten)]
    globals: Globals,
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Global options")]
struct Globals {
    /// Address of the server's gRPC port
    #[arg(
        long,
        global = true,
        env = "WAYPOST_SERVER",
        default_value = "http://127.0.0.1:7600",
        value_name = "URL"
    )]
    server: String,
    /// Print exactly one JSON object on stdout when done, and nothing else there
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Train, list, show, copy and delete models
    #[command(subcommand, after_help = EXIT_CODES)]
    Model(model::Command),
    /// Look after training that was started with --detach
    #[command(subcommand, after_help = EXIT_CODES)]
    Job(job::Command),
    /// Create, list, show and delete maps
    #[command(subcommand, after_help = EXIT_CODES)]
    Map(map::Command),
    Stream(stream::Arguments),
    Demo(demo::Arguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    // The library warns of lost connections.
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_max_level(tracing::Level::WARN)
        .without_time()
        .with_level(false)
        .with_target(false)
        .init();
    let finished = tokio::runtime::Runtime::new().map_err(Failure::Runtime).and_then(|runtime| {
        let finished = runtime.block_on(run(arguments));
        // A reading thread must not hold up the end.
        runtime.shutdown_background();
        finished
    });
    match finished {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_stdout() => ExitCode::SUCCESS,
        Err(failure) => {
            // With stderr closed there is nobody to tell.
            let _ = writeln!(std::io::stderr(), "waypost: {failure}{}", failure.hint());
            failure.exit_code()
        }
    }
}

async fn run(Arguments { globals: Globals { server, json }, command }: Arguments) -> Result<(), Failure> {
    let output = if json { Output::Json } else { Output::Text };
    match command {
        Command::Model(command) => model::run(command, &server, output).await,
        Command::Job(command) => job::run(command, &server, output).await,
        Command::Map(command) => map::run(command, &server, output).await,
        Command::Stream(arguments) => stream::run(arguments, &server, output).await,
        Command::Demo(arguments) => demo::run(arguments, output).await,
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }
}
