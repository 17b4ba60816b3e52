//! `waypost-eval load`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use waypost_eval::commands::load::{
    self, GrowthOptions, LeadingOptions, OverloadOptions, PanoramasOptions, RobotsOptions, ServerOptions,
    WordSource, WordsOptions,
};
use waypost_eval::error::EvalError;
use waypost_eval::workload::WorkloadSettings;

use crate::print_if;

/// Put a real server under load: it is started on a temporary directory, driven over gRPC, and stopped.
#[derive(Args)]
pub(crate) struct LoadArguments {
    #[command(subcommand)]
    scenario: Scenario,
    /// The model that the server's map is made with.
    #[arg(long, global = true, value_name = "FILE", default_value = "demo/model.waypost")]
    model: PathBuf,
    /// The server [default: waypost-server beside this program].
    #[arg(long, global = true, value_name = "FILE")]
    server_binary: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Scenario {
    /// Many word streams into one map: what a frame takes beyond computing.
    Words {
        #[command(flatten)]
        source: WordSourceArguments,
        /// Robots.
        #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
        streams: u32,
        /// Frames a second of each robot.
        #[arg(long, value_name = "HZ", default_value_t = 2.0, value_parser = positive)]
        rate_hz: f64,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
    },
    /// More images than the server can work off: goodput, memory, recovery.
    Overload {
        /// Folder of JPEG or PNG images.
        #[arg(long, value_name = "DIR")]
        images: PathBuf,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
        /// How many times the peak goodput is offered.
        #[arg(long, value_name = "TIMES", default_value_t = 5.0, value_parser = positive)]
        factor: f64,
    },
    /// A map that grows large: what looks wait for beside its checkpoints, and how long it takes to open. Its words
    /// are drawn, and so is its model.
    Growth {
        /// Frames, each of another place.
        #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        places: u32,
        /// Number of words of the vocabulary.
        #[arg(long, value_name = "V", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
        words: u32,
        /// Looks a second at places of the grown map.
        #[arg(long, value_name = "HZ", default_value_t = 25.0, value_parser = positive)]
        rate_hz: f64,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
    },
    /// Robots that are led along one map: how long they wait for commands.
    Leading {
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
        #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = positive)]
        seconds: f64,
    },
    /// Panoramas into maps with and without an appearance graph: answers' latencies, and how long the graph takes to be built
    /// anew.
    Panoramas {
        /// Panoramas, taken all over a simulated office.
        #[arg(long, value_name = "N", default_value_t = 600)]
        panoramas: usize,
        /// Panoramas a second.
        #[arg(long, value_name = "HZ", default_value_t = 4.0, value_parser = positive)]
        rate_hz: f64,
        /// Of building and poses.
        #[arg(long, value_name = "S", default_value_t = 1)]
        seed: u64,
    },
    /// Four robots in one map, alone and beside clients that do not read their answers.
    Robots {
        #[command(flatten)]
        source: WordSourceArguments,
        /// Frames a second of each robot.
        #[arg(long, value_name = "HZ", default_value_t = 5.0, value_parser = positive)]
        rate_hz: f64,
        /// How long, each time.
        #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = positive)]
        seconds: f64,
    },
}

#[derive(Args)]
#[group(required = true)]
pub(crate) struct WordSourceArguments {
    /// Folder of JPEG or PNG images that words are made of beforehand.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Words of the model's sampling set, so that no images are needed.
    #[arg(long, conflicts_with = "images")]
    synthetic: bool,
}

impl LoadArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { scenario, model, server_binary, json } = self;
        let server = ServerOptions { binary: server_binary, model };
        match scenario {
            Scenario::Growth { places, words, rate_hz, seconds } => {
                let workload = WorkloadSettings { words, ..WorkloadSettings::default() };
                let duration = Duration::from_secs_f64(seconds);
                let options = GrowthOptions { workload, places, rate_hz, duration };
                print_if(json, &load::growth(server.binary, &options)?)
            }
            Scenario::Words { source, streams, rate_hz, seconds } => {
                let (source, duration) = (source.source(), Duration::from_secs_f64(seconds));
                print_if(json, &load::words(&server, &WordsOptions { source, streams, rate_hz, duration })?)
            }
            Scenario::Overload { images, seconds, factor } => {
                let duration = Duration::from_secs_f64(seconds);
                print_if(json, &load::overload(&server, &OverloadOptions { images, duration, factor })?)
            }
            Scenario::Leading { images, robots, rate_hz, seconds } => {
                let duration = Duration::from_secs_f64(seconds);
                print_if(
                    json,
                    &load::leading(&server, &LeadingOptions { images, robots, rate_hz, duration })?,
                )
            }
            Scenario::Panoramas { panoramas, rate_hz, seed } => {
                print_if(json, &load::panoramas(&server, &PanoramasOptions { panoramas, rate_hz, seed })?)
            }
            Scenario::Robots { source, rate_hz, seconds } => {
                let (source, duration) = (source.source(), Duration::from_secs_f64(seconds));
                print_if(json, &load::robots(&server, &RobotsOptions { source, rate_hz, duration })?)
            }
        }
    }
}

impl WordSourceArguments {
    fn source(self) -> WordSource {
        let Self { images, synthetic: _ } = self;
        images.map_or(WordSource::SamplingSet, WordSource::Images)
    }
}

/// A duration, a rate or a factor.
fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.1..=3600.0).contains(&value) { Ok(value) } else { Err("give a number from 0.1 to 3600".to_owned()) }
}
