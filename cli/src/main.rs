//! The `waypost` command line: models, maps and streams of a Waypost server.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};

use commands::{
    closure, cluster, demo, explain, import, inspect, job, map, merge, model, navigate, query, refusals,
    session, shell, simulate, stream, token,
};
use failure::{EXIT_CODES, Failure};
use output::Output;
use waypost_client::ClientOptions;

mod camera_file;
mod commands;
mod conventions;
mod corrections;
mod drive;
mod explanations;
mod failure;
mod file_stamps;
mod files;
mod frame_row;
mod images;
mod moments;
mod names;
mod odometry;
mod output;
mod panorama;
mod progress;
mod reasons;
mod replay;
mod resumed;
mod robot_words;
mod rtab_drive;
mod shrinking;
mod simulated;
mod truth;
mod units;

/// Place recognition and maps from a robot's images, on a Waypost server
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
        default_value = DEFAULT_SERVER,
        value_name = "URL"
    )]
    server: String,
    /// Secret of a token, if the server requires one
    #[arg(long, global = true, env = "WAYPOST_TOKEN", hide_env_values = true, value_name = "SECRET")]
    token: Option<String>,
    /// Authority that issued the server's certificate (PEM); if left out, those that the system
    /// trusts
    #[arg(long, global = true, env = "WAYPOST_CA", value_name = "FILE", value_parser = any_path())]
    ca: Option<PathBuf>,
    /// Client certificate, if the server requires one (PEM)
    #[arg(long, global = true, env = "WAYPOST_CLIENT_CERT", value_name = "FILE", value_parser = any_path())]
    client_cert: Option<PathBuf>,
    /// Private key of that certificate (PEM)
    #[arg(long, global = true, env = "WAYPOST_CLIENT_KEY", value_name = "FILE", value_parser = any_path())]
    client_key: Option<PathBuf>,
    /// Print one JSON object on stdout at the end, and nothing else there
    #[arg(long, global = true)]
    json: bool,
}

const DEFAULT_SERVER: &str = "http://127.0.0.1:7600";

/// A path, or nothing: a variable of the environment may be set to that.
fn any_path() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(PathBuf::from)
}

impl Globals {
    /// How to reach the server. An empty environment variable counts as unset.
    fn options(self) -> Result<ClientOptions, Failure> {
        let Globals { server, token, ca, client_cert, client_key, json: _ } = self;
        let server = if server.is_empty() { DEFAULT_SERVER.to_owned() } else { server };
        let [ca, client_cert, client_key] =
            [ca, client_cert, client_key].map(|path| path.filter(|path| !path.as_os_str().is_empty()));
        let mut options = ClientOptions::new(server);
        if let Some(token) = token.filter(|token| !token.is_empty()) {
            options = options.with_token(token);
        }
        if let Some(ca) = ca {
            options = options.with_ca(read(&ca)?);
        }
        match (client_cert, client_key) {
            (Some(certificate), Some(key)) => Ok(options.with_identity(read(&certificate)?, read(&key)?)),
            (None, None) => Ok(options),
            (Some(_), None) | (None, Some(_)) => Err(Failure::Unfit(
                "a certificate and its key go together; give both --client-cert and --client-key".to_owned(),
            )),
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(path).map_err(Failure::file("read", path))
}

#[derive(Subcommand)]
enum Command {
    /// Train, list, show, copy and delete models
    #[command(subcommand, after_help = EXIT_CODES)]
    Model(model::Command),
    /// List, follow and cancel jobs of the server: trainings, imports and merges of maps
    #[command(subcommand, after_help = EXIT_CODES)]
    Job(job::Command),
    /// Create, list, show, copy and delete maps
    #[command(subcommand, after_help = EXIT_CODES)]
    Map(map::Command),
    /// Show, commit, discard and undo merges of maps; `waypost map merge` starts one
    #[command(subcommand, after_help = EXIT_CODES)]
    Merge(merge::Command),
    /// Withdraw loop closures that are wrong, confirm those that the map missed, and undo both
    #[command(subcommand, after_help = EXIT_CODES)]
    Closure(closure::Command),
    /// List and delete the sessions of a map, and show the decisions about their frames
    #[command(subcommand, after_help = EXIT_CODES)]
    Session(session::Command),
    /// Create, list and delete tokens
    #[command(subcommand, after_help = EXIT_CODES)]
    Token(token::Command),
    Stream(stream::Arguments),
    Import(import::Arguments),
    Inspect(inspect::Arguments),
    Query(query::Arguments),
    Explain(explain::Arguments),
    Navigate(navigate::Arguments),
    Refusals(refusals::Arguments),
    Cluster(cluster::Arguments),
    Simulate(simulate::Arguments),
    Demo(demo::Arguments),
    Completions(shell::Completions),
    Man(shell::Manual),
}

/// Why a command uses no server that is running; `None` if it does.
fn why_no_server(command: &str) -> Option<&'static str> {
    match command {
        "demo" => Some(
            "a demo starts a server of its own; leave it out, or drive a simulated robot against that server with \
             `waypost simulate`",
        ),
        "inspect" => Some("what is in a file is shown without a server; leave it out"),
        "completions" | "man" => Some("this is written without a server; leave it out"),
        _ => None,
    }
}

/// Refuses options about a server where none is used: what people give is used, or they are told that it is not. What
/// the environment says is meant for all commands; a demo alone says that it goes by other ways.
fn check_server_options(matches: &ArgMatches) -> Result<(), clap::Error> {
    let Some((command, why)) = matches.subcommand_name().and_then(|name| Some((name, why_no_server(name)?)))
    else {
        return Ok(());
    };
    let from = |source| move |id: &&str| matches.value_source(id) == Some(source);
    let options = || SERVER_OPTIONS.into_iter();
    if let Some(given) = options().find(from(ValueSource::CommandLine)) {
        let option = given.replace('_', "-");
        let refused = format!("--{option} is not used here: {why}");
        return Err(plain_usage(Arguments::command()).error(ErrorKind::ArgumentConflict, refused));
    }
    if command == "demo" && options().any(|id| from(ValueSource::EnvVariable)(&id)) {
        // If stderr is closed, the note is lost.
        let _ = writeln!(std::io::stderr(), "the server of the environment is not used: {why}");
    }
    Ok(())
}

fn main() -> ExitCode {
    let matches = plain_usage(Arguments::command()).get_matches();
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    check_server_options(&matches).unwrap_or_else(|error| error.exit());
    // The library warns of lost connections.
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        // Where nobody reads it any more, saying so would panic.
        .log_internal_errors(false)
        .with_max_level(tracing::Level::WARN)
        .without_time()
        .with_level(false)
        .with_target(false)
        .init();
    let finished = tokio::runtime::Runtime::new().map_err(Failure::Runtime).and_then(|runtime| {
        let finished = runtime.block_on(run(arguments));
        // Does not wait for threads that still read.
        runtime.shutdown_background();
        finished
    });
    match finished {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_stdout() => ExitCode::SUCCESS,
        Err(failure) => {
            // If stderr is closed, the message is lost.
            let _ = writeln!(std::io::stderr(), "waypost: {failure}{}", failure.hint());
            failure.exit_code()
        }
    }
}

/// Options about a server.
const SERVER_OPTIONS: [&str; 5] = ["server", "token", "ca", "client_cert", "client_key"];

/// The help of commands that use no server does not offer what they refuse.
fn without_server_options(command: clap::Command) -> clap::Command {
    let hidden: Vec<clap::Arg> = command
        .get_arguments()
        .filter(|argument| SERVER_OPTIONS.contains(&argument.get_id().as_str()))
        .map(|argument| argument.clone().hide(true))
        .collect();
    command.mut_subcommands(|within| match why_no_server(within.get_name()) {
        Some(_) => within.args(hidden.clone()),
        None => within,
    })
}

/// The command with the usage lines that its help has in errors too: there clap would add what was given, the server's
/// address in the environment among it, as if that were needed.
fn plain_usage(command: clap::Command) -> clap::Command {
    let command = without_server_options(command);
    let mut whole = command.clone();
    whole.build();
    as_in_help(command, &mut whole)
}

fn as_in_help(command: clap::Command, whole: &mut clap::Command) -> clap::Command {
    let usage = whole.render_usage().to_string();
    let within: Vec<String> = command.get_subcommands().map(|within| within.get_name().to_owned()).collect();
    let command = command.override_usage(usage.trim_start_matches("Usage: ").to_owned());
    within.iter().fold(command, |command, name| {
        command.mut_subcommand(name, |within| match whole.find_subcommand_mut(name) {
            Some(whole) => as_in_help(within, whole),
            None => within,
        })
    })
}

async fn run(Arguments { globals, command }: Arguments) -> Result<(), Failure> {
    let output = if globals.json { Output::Json } else { Output::Text };
    let server = globals.options()?;
    match command {
        Command::Model(command) => model::run(command, &server, output).await,
        Command::Job(command) => job::run(command, &server, output).await,
        Command::Map(command) => map::run(command, &server, output).await,
        Command::Merge(command) => merge::run(command, &server, output).await,
        Command::Closure(command) => closure::run(command, &server, output).await,
        Command::Session(command) => session::run(command, &server, output).await,
        Command::Query(arguments) => query::run(arguments, &server, output).await,
        Command::Explain(arguments) => explain::run(arguments, &server, output).await,
        Command::Navigate(arguments) => navigate::run(arguments, &server, output).await,
        Command::Refusals(arguments) => refusals::run(arguments, &server, output).await,
        Command::Cluster(arguments) => cluster::run(arguments, &server, output).await,
        Command::Token(command) => token::run(command, &server, output).await,
        Command::Stream(arguments) => stream::run(arguments, &server, output).await,
        Command::Import(arguments) => import::run(arguments, &server, output).await,
        Command::Simulate(arguments) => simulate::run(arguments, &server, output).await,
        Command::Inspect(arguments) => inspect::run(arguments, output).await,
        Command::Demo(arguments) => demo::run(arguments, output).await,
        Command::Completions(asked) => shell::completions(&asked, Arguments::command()),
        Command::Man(asked) => shell::manual(&asked, Arguments::command()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
        plain_usage(Arguments::command()).debug_assert();
    }

    /// The usage line of an error.
    fn usage(arguments: &str) -> String {
        let server = ["waypost", "--server", "http://127.0.0.1:1"];
        let given = server.into_iter().chain(arguments.split_whitespace());
        let refused = plain_usage(Arguments::command()).try_get_matches_from(given).unwrap_err().to_string();
        let line = refused.lines().find_map(|line| line.strip_prefix("Usage: "));
        line.unwrap_or_else(|| panic!("{refused}")).to_owned()
    }

    #[test]
    fn help_offers_a_server_where_one_is_used() {
        let whole = plain_usage(Arguments::command());
        for command in whole.clone().get_subcommands() {
            let name = command.get_name();
            let help = plain_usage(Arguments::command())
                .try_get_matches_from(["waypost", name, "--help"])
                .unwrap_err()
                .to_string();
            let uses_none = ["demo", "inspect", "completions", "man"].contains(&name);
            assert_eq!(help.contains("--server <URL>"), !uses_none, "{name}: {help}");
            assert!(help.contains("--json"), "{name}");
        }
    }

    #[test]
    fn what_is_not_offered_is_refused_with_its_reason() {
        let matches = |given: &[&str]| plain_usage(Arguments::command()).try_get_matches_from(given).unwrap();
        let given = matches(&["waypost", "demo", "--server", "http://h:1"]);
        let refused = check_server_options(&given).unwrap_err().to_string();
        assert!(refused.contains("--server is not used here: a demo starts a server"), "{refused}");
    }

    #[test]
    fn what_the_environment_leaves_empty_is_unset() {
        let empty = ["", "", ""].map(|path| Some(PathBuf::from(path)));
        let [ca, client_cert, client_key] = empty;
        let globals = Globals {
            server: String::new(),
            token: Some(String::new()),
            ca,
            client_cert,
            client_key,
            json: false,
        };
        let options = format!("{:?}", globals.options().unwrap());
        assert!(options.contains(DEFAULT_SERVER), "{options}");
        let given = ["waypost", "--ca", "", "--client-cert", "", "map", "ls"];
        assert!(plain_usage(Arguments::command()).try_get_matches_from(given).is_ok());
    }

    #[test]
    fn usage_lines_name_what_is_needed_and_nothing_else() {
        assert_eq!(usage("map show"), "waypost map show [OPTIONS] <NAME>");
        assert_eq!(usage("stream images"), "waypost stream [OPTIONS] --map <MAP> <DIR>");
        assert_eq!(usage("map lss"), "waypost map [OPTIONS] <COMMAND>");
    }
}
